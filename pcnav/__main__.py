"""``python -m pcnav``: the command line."""

from pcnav.cli import main

if __name__ == "__main__":
    main()
