"""Case files solved on the ranks of MPI."""
