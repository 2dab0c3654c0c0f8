"""Systems: components wired into a drive chain."""

from hybrid_id.systems.builders import one_link, one_link_flexible, two_link
from hybrid_id.systems.chain import System

__all__ = ["System", "one_link", "one_link_flexible", "two_link"]
