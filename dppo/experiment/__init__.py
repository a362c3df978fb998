"""Grids of training runs: what an experiment runs, how it is run, and what came out.

    plan.py, grid_file.py, table2.py   environments x arms x seeds
    settings.py                        an arm's settings as flags, and what they resolve to
    schedule.py, pace.py               which run is next, how long it takes: no process, no clock
    folder.py, processes.py, work.py   files, subprocesses and the loop around them
    evaluation.py, measure.py          what runs leave behind, as arrays
    statistics.py, compare.py          intervals and tests
    results.py, verdicts.py            results.json, and sentences computed from it
    report.py, page.py, figures.py     the report as Markdown and HTML

Trainers and evaluations are subprocesses: nothing here imports learner or workers.
"""
