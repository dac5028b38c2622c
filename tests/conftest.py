"""Lets every test import `support`, and gives libraries one thread, as the commands do: the same sums, and faster."""

import os
import sys
from pathlib import Path

from lampest.runs.executors import ONE_THREAD

os.environ.update({name: value for name, value in ONE_THREAD.items() if name not in os.environ})
sys.path.insert(0, str(Path(__file__).parent))
