"""The Compose file with a real engine: build, eight workers, who is killed comes back, clean up.

It needs root, because it kills a container's process from the host, and it is skipped where no
engine answers unless DPPO_REQUIRE_DOCKER=1. On a machine that reaches no registry, first run
`deploy/docker-here.sh setup > /tmp/engine.env && . /tmp/engine.env`: it exports PIP_EXTRA,
which the Compose file hands to the build, and DPPO_REQUIRE_DOCKER.
"""

import json
import os
import signal
import subprocess
import time
import uuid
from pathlib import Path

import pytest

pytestmark = pytest.mark.docker

ROOT = Path(__file__).parents[2]
WORKERS = 8
RUN = {"DPPO_ENV": "InvertedPendulum-v5", "DPPO_TOTAL_TIMESTEPS": "100000000", "DPPO_RUN": "main"}


def run(*command, seconds=60, check=True):
    return subprocess.run(
        command,
        check=check,
        cwd=ROOT,
        env=os.environ | RUN,
        text=True,
        capture_output=True,
        timeout=seconds,
    )


def compose(project, *arguments, **options):
    return run("docker", "compose", "-p", project, *arguments, **options)


def containers(project, service):
    """What the engine says of every container of a service, by container id."""
    ids = compose(project, "ps", "--all", "--quiet", service).stdout.split()
    return {each["Id"]: each for each in json.loads(run("docker", "inspect", *ids).stdout)}


def health(project):
    return [c["State"]["Health"]["Status"] for c in containers(project, "learner").values()]


def iterations(project):
    """The complete lines of the learner's metrics, oldest first; none before the first one."""
    file = compose(
        project, "exec", "-T", "learner", "cat", "/runs/main/metrics.jsonl", check=False
    )
    return [json.loads(line) for line in file.stdout.split("\n")[:-1]]


def full_iterations(project, after=0):
    rows = iterations(project)
    return [r for r in rows if r["iteration"] > after and r["cluster/workers"] == WORKERS]


def wait_for(project, what, fact, seconds):
    """Return once `fact` is true; the test fails if it is not so at the deadline."""
    deadline = time.monotonic() + seconds
    while not fact():
        if time.monotonic() > deadline:
            last = (iterations(project) or ["not there yet"])[-1]
            pytest.fail(f"{what}: not so within {seconds} s; the last metrics line is {last}")
        time.sleep(0.5)


def left_over(project):
    label = f"label=com.docker.compose.project={project}"
    kinds = (("container", "--all"), ("volume",), ("network",))
    return [run("docker", k, "ls", "-q", *more, "--filter", label).stdout for k, *more in kinds]


def unavailable(reason):
    if os.environ.get("DPPO_REQUIRE_DOCKER") == "1":
        pytest.fail(f"{reason}, and DPPO_REQUIRE_DOCKER=1 asks for one")
    pytest.skip(reason)


@pytest.fixture
def project():
    for command in (("docker", "info"), ("docker", "compose", "version")):
        try:
            run(*command)
        except FileNotFoundError:
            unavailable("no Docker engine: there is no docker command")
        except subprocess.CalledProcessError as error:
            unavailable(f"no Docker engine: '{' '.join(command)}' said '{error.stderr.strip()}'")
    if os.geteuid() != 0:
        unavailable("no Docker engine for this user: root is needed to kill a container's process")
    name = f"dppo-test-{uuid.uuid4().hex[:8]}"
    yield name
    # Not captured here, so that pytest shows the logs when the test failed.
    subprocess.run(("docker", "compose", "-p", name, "logs", "--tail=50"), cwd=ROOT, check=False)
    compose(name, "down", "-v", seconds=120)


def kill(project, service):
    """Kill one container's process, see it restarted and eight workers train again."""
    victim = next(iter(containers(project, service).values()))
    before = iterations(project)[-1]["iteration"]
    os.kill(victim["State"]["Pid"], signal.SIGKILL)
    wait_for(
        project,
        f"the killed {service} restarted",
        lambda: containers(project, service)[victim["Id"]]["RestartCount"] == 1,
        60,
    )
    wait_for(
        project,
        f"three more iterations with {WORKERS} workers",
        lambda: len(full_iterations(project, after=before)) >= 3,
        180,
    )


def restarts(project, service):
    return sorted(each["RestartCount"] for each in containers(project, service).values())


def test_eight_workers_train_and_whoever_is_killed_comes_back(project):
    up = compose(
        project, "up", "-d", "--build", "--scale", f"worker={WORKERS}", seconds=900, check=False
    )
    assert up.returncode == 0, up.stderr
    wait_for(
        project, "three iterations with 8 workers", lambda: len(full_iterations(project)) >= 3, 300
    )
    (learner,) = containers(project, "learner").values()
    wait_for(project, "the learner healthy", lambda: health(project) == ["healthy"], 60)

    for service in ("learner", "worker"):
        assert compose(project, "exec", "-T", service, "id", "-u").stdout.strip() != "0"
        touch = compose(project, "exec", "-T", service, "touch", "/here", check=False)
        assert "Read-only file system" in touch.stderr

    kill(project, "worker")
    assert restarts(project, "worker") == [0] * (WORKERS - 1) + [1]
    (same,) = containers(project, "learner").values()
    assert same["RestartCount"] == 0
    assert same["State"]["StartedAt"] == learner["State"]["StartedAt"]

    kill(project, "learner")
    assert restarts(project, "learner") == [1]
    assert restarts(project, "worker") == [0] * (WORKERS - 1) + [1]  # they outlived it

    compose(project, "stop", seconds=120)
    everyone = containers(project, "learner") | containers(project, "worker")
    assert {each["State"]["ExitCode"] for each in everyone.values()} == {0}
    compose(project, "down", "-v", seconds=120)
    assert left_over(project) == ["", "", ""]
