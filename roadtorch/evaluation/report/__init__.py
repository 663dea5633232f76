"""What a run leaves behind: tables on the screen, files, a page, sheets of images."""
