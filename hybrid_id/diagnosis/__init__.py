"""Where the gap between records and the nominal model lies, which effect causes it, and how far it shrinks."""
