"""`python -m cnclik` is `cnclik`."""

from cnclik.cli import main

if __name__ == "__main__":
    main()
