"""`python -m rsrectify_program`."""

import sys

from . import main

sys.exit(main())
