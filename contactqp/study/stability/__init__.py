"""Where methods break: axes of difficulty, each swept with exact truths, and what every method makes of them."""
