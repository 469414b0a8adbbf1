# SPDX-License-Identifier: MIT OR Apache-2.0

"""`python -m rsrectify_batch`."""

import sys

from .cli import main

sys.exit(main())
