"""The batched forward models: motion and parameters in, force out."""
