"""Case files that are solved on the ranks of MPI."""
