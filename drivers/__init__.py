"""What the plant says: tags in, samples out."""
