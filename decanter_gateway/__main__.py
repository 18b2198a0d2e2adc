"""`python -m decanter_gateway` is `decanter`."""

from decanter_gateway.start import main

if __name__ == "__main__":
    main()
