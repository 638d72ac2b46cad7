"""Building a data set: executors for this machine, Dask and Slurm."""
