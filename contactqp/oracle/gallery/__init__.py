"""Problems whose answers are known exactly, by construction."""
