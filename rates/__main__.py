# SPDX-License-Identifier: Apache-2.0
"""`python -m rates`."""

import sys

from rates.run import main

if __name__ == "__main__":
    sys.exit(main())
