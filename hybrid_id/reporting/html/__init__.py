"""One self-contained page for a result: text, tables and pictures in one file that opens without a network."""
