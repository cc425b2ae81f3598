# %% [markdown]
# # Reading a log in Python
#
# Run it cell by cell in an editor that knows `# %%`, or whole: `python docs/examples/read_log.py out/demo/run.mcap`.

# %%
import sys

import numpy as np

from autopilot import open_log
from autopilot.core.errors import AutopilotError

log = open_log(sys.argv[1] if len(sys.argv) > 1 else "out/demo/run.mcap")
print(log.run.get("scenario"), f"{log.duration_s:.1f} s,", log.message_count, "messages")

# %% [markdown]
# A topic is a numpy structured array: one row per message, `t_us` on the service's clock, then the fields.

# %%
nmpc = log["/ctl/nmpc"]
print("control steps:", len(nmpc), "median", f"{1e3 * np.median(nmpc['solve_s']):.2f} ms")

# %% [markdown]
# Topics of different rates on one clock: at 20 Hz, each topic's last message.

# %%
both = log.align(["/nav/state", "/ctl/nmpc"], rate_hz=20.0)
depth_m = both["/nav/state"]["pos_ned_m"][:, 2]
print("correlation of depth and margin:", f"{np.corrcoef(depth_m, both['/ctl/nmpc']['margin_m'])[0, 1]:.2f}")

# %% [markdown]
# As a pandas table, where the extra `analysis` is installed.

# %%
try:
    print(nmpc.to_pandas().describe()[["solve_s", "iterations"]])
except AutopilotError as error:
    print(error)

# %% [markdown]
# What the run was, what it was judged by, and its verdicts.

# %%
from autopilot.log.check import acceptance_table  # noqa: E402

for row in acceptance_table(log):
    if row.margin is not None:
        print(f"{row.name:<40} {row.verdict.value:<5} {row.margin:.4g} {row.unit}")
