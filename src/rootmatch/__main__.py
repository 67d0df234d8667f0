"""``python -m rootmatch`` is the command line."""

from rootmatch.cli import main

if __name__ == "__main__":
    main()
