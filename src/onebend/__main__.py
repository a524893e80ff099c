"""`python -m onebend` is `onebend`."""

from onebend.cli import main

if __name__ == "__main__":
    main()
