"""A standard set against all models, run by run: what became worse since which version."""
