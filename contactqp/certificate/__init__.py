"""What an answer violates and how far it is from the truth, whatever method made it."""
