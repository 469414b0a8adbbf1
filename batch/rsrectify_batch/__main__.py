"""`python -m rsrectify_batch`."""

import sys

from .cli import main

sys.exit(main())
