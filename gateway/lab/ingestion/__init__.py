"""Files from elsewhere into an archive: recognised by the rooms that read them, copied whole, listed in a manifest."""
