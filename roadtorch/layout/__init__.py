"""Scene layout: sky, vertical, horizontal (P2, section 3); the networks and their weight files."""
