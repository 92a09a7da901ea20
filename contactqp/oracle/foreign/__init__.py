"""Other people's answers: read as told, completed, certified, with the right values beside."""
