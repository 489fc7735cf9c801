"""A campaign of damaged and hostile input against every reader; `bench_fuzz.py` beside this folder runs it."""
