"""Study numerical stability: sweep families of problems of growing difficulty with exact solutions over all methods."""
