"""The `imucald` command, and ``python -m imucald``: Ctrl-C ends it in one line from the first."""

import sys


def main() -> int:
    """Entry point; returns the exit status."""
    try:
        from imucald import cli  # noqa: PLC0415 - its imports take some time
    except KeyboardInterrupt:
        print("imucald: interrupted", file=sys.stderr)
        return 130
    return cli.main()


if __name__ == "__main__":
    sys.exit(main())
