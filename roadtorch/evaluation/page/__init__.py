"""One page that a person reads: the figures of a run as tables, charts and sentences."""
