"""Grids of training runs: what an experiment runs, how it is run, and what came out.

    plan.py, grid_file.py, table2.py   environments x arms x seeds
    settings.py                        an arm's settings as flags, and what they resolve to
    schedule.py, pace.py               which run is next, how long it takes: no process, no clock
    folder.py, processes.py, work.py   files, subprocesses and the loop around them
    evaluation.py, measure.py          what runs leave behind, as arrays
    statistics.py, significance.py     figures, their intervals, and tests
    compare.py, calibrated.py          an arm's figures, and the arm against the baseline
    results.py                         results.json
    verdicts.py, claims.py             sentences computed from it; the paper's claims
    tables.py, policy_tables.py        tables; numbers.py, how_to_read.py: what is in them
    report.py, page.py, figures.py     the report as Markdown and HTML

Trainers and evaluations are subprocesses: nothing here imports learner or workers.
"""
