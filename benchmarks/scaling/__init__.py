"""One contact problem on more and more ranks: seconds, memory, messages, and what they make of larger ones."""
