"""``python -m contactqp`` is the command line."""

from contactqp.cli import main

if __name__ == "__main__":
    main()
