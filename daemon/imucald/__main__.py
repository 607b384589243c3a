"""The command `imucald`, and ``python -m imucald``. From the first moment on, Ctrl-C ends the
program with a single line of text."""

import sys


def main() -> int:
    """Entry point. Return the exit status."""
    try:
        from imucald import cli  # noqa: PLC0415 - its imports take some time
    except KeyboardInterrupt:
        print("imucald: interrupted", file=sys.stderr)
        return 130
    return cli.main()


if __name__ == "__main__":
    sys.exit(main())
