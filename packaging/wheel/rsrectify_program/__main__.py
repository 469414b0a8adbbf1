# SPDX-License-Identifier: MIT OR Apache-2.0

"""`python -m rsrectify_program`."""

import sys

from . import main

sys.exit(main())
