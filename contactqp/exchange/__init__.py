"""Files of other codes, one format a module: FCLIB's HDF5 in and out, Siconos's text in."""
