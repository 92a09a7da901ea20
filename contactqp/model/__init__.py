"""What a problem, an answer and a verdict are: frozen data, and no algorithm."""
