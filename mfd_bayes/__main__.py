"""The command line, as python -m mfd_bayes."""

from mfd_bayes.cli.commands import main

if __name__ == "__main__":
    main()
