"""Building data sets and single frames: in this process, in worker processes, by Dask and by Slurm."""
