"""``python -m vascval.cli``: the command line without its script."""

import sys

from vascval.cli.main import main

sys.exit(main())
