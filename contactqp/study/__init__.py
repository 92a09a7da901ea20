"""Cases × methods × knobs: errors, run times and verdicts in one flat table, and the report made of it."""
