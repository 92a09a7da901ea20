"""Decks of Abaqus and CalculiX as bodies, loads and contacts: what they state becomes a contact problem."""
