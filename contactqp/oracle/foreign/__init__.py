"""Complete, certify and compare answers of other codes."""
