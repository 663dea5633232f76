"""The page on which a person corrects machine labels."""
