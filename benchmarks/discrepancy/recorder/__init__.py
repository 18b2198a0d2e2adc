"""A fourth plant for the diagnosis, recorder first: what reaches the file is drawn before what the machine does."""
