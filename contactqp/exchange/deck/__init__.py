"""Input decks of Abaqus and CalculiX: cards, keywords, and the model that they state."""
