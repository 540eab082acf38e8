"""`python -m experiments run|report|gate|list`."""

from experiments.cli import main

if __name__ == "__main__":
    main()
