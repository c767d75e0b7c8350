"""``duplex batch``: many pairs of recordings, in processes of this machine or on a Dask cluster."""
