"""What a recorder does to a record must not decide what is said of it: random corruptions of five small records."""
