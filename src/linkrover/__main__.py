"""`python -m linkrover`."""

from linkrover.cli.main import main

if __name__ == "__main__":
    main()
