"""Turn input decks of Abaqus and CalculiX into bodies, loads, contact pairs and a contact problem."""
