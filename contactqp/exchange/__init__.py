"""Files of other codes, one format a module: matrices, answers, decks, frictional contact of FCLIB and Siconos."""
