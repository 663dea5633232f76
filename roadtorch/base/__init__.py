"""Files in and out: bounded reads, atomic writes, images."""
