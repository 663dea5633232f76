"""Road between two borders that meet in a vanishing point (Kong et al. 2010, a baseline of P1)."""
