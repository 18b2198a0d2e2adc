"""The program's door: it looks whose packages are about to be imported, then calls the command line."""
