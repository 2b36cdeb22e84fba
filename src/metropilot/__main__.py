"""``python -m metropilot``: the command line where its script is not on the path."""

from metropilot.cli import main

if __name__ == "__main__":
    main()
