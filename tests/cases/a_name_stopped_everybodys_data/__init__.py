"""A tag's name that a broker refuses stopped all data; others arrived under another's name, or at another address."""
