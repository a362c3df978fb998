"""The Four Rooms experiment of Safe Actor-Critic: world, oracle, agent, statistics, figures.

- world.py, mdp.py: the map as arrays, and any small world as arrays
- agent.py, settings.py, draws.py: Algorithm 1 for many trials at once, its settings, its draws
- oracle.py, gradients.py, optimum.py: exact V and σ, eq. 15, the best policy under eq. 9
- experiment.py, rollouts.py, summary.py: what is compared, run and measured
- processes.py, trial_process.py: trials spread over processes
- results.py, pictures.py, figures.py, maps.py, style.py, report.py, verdicts.py: what is written
- command.py, console.py: `dppo four-rooms`
"""
