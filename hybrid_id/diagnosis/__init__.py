"""Where the gap between records and today's simulator lies, which effect causes it, and how far it shrinks."""
