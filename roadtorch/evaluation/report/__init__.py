"""Output of an evaluation: tables on the screen, files, an HTML page, montages of images."""
