"""How readings come in and what each is worth: the clock, the scan, several links, quality."""
