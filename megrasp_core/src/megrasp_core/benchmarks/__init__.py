"""Speed and rates.

- `synthesis`, `training`, `data`, `rendering`: what `megrasp bench` measures.
- `learning`: what a trainer has learned after so much CPU time, beside an older one.
- `serving`: requests to the resident planner; `startup`: until a command can begin.
- `bins`, with `bin_scenes`: how often and how well bins are found, and none on tables.
- `ros`: starts the program of the ROS package that measures grasp_server.
- `trial_profile`, `rate_tables`, `data_plan`: where the time of a trial goes, tables, core-hours
  of a large data set.
- `checkout`: older checkouts that some of them compare with.
- `object_pieces`: convex pieces of prepared objects against those of others.
"""
