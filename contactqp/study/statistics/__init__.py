"""What the rows of a study come to: each number of a report that is no row's own is computed here."""
