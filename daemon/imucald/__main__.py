"""``python -m imucald``."""

import sys

from imucald.cli import main

sys.exit(main())
