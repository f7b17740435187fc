"""`python -m dynid`: the command line."""

from dynid.command import main

if __name__ == "__main__":
    main()
