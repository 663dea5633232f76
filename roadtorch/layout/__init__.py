"""Scene layout: sky, vertical, horizontal (P2, section 3)."""
