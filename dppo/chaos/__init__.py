"""Faults on purpose, in real processes: what dies, stalls or lies costs time, never bits.

plan.py      which fault, when, on whom; drawn from a seed or read from a file
weather.py   what a link does to bytes: late, slow, held back, altered, cut off
proxy.py     a link with such weather, between a worker and the learner
processes.py processes started, watched and ended
cast.py      a learner and its workers, and what each fault does to them
drill.py     one run with its faults, from start to end
command.py   `dppo chaos`
"""
