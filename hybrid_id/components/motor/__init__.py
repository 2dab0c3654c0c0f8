"""Motors, and what acts beside them."""
