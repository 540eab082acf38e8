"""`python -m experiments run|report|gate|survey|list`."""

from experiments.cli import main

if __name__ == "__main__":
    main()
