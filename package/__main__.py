"""`python -m bristle`: the command line."""

from bristle.cli.main import main

if __name__ == "__main__":
    main()
