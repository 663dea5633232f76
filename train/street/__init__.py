"""Learning the networks of `fusion` on one GPU: pack, recipes, batches, learning, comparison."""
