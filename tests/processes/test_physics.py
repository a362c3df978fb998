"""Models that step sooner: what is left out, and that nothing else changes."""

from typing import Any

import gymnasium
import mujoco
import pytest

from workers.physics import WithoutTimer, contact_pairs, tuned

pytestmark = pytest.mark.usefixtures("quiet_libraries")


def test_the_pairs_are_those_that_the_engine_finds():
    ant: Any = gymnasium.make("Ant-v4").unwrapped
    floor, geoms = 0, range(1, 14)
    assert contact_pairs(ant.model) == [(floor, geom) for geom in geoms]
    reacher: Any = gymnasium.make("Reacher-v5").unwrapped
    assert contact_pairs(reacher.model) == []


@pytest.mark.parametrize("name", ["Ant", "HalfCheetah", "Hopper", "Walker2d"])
@pytest.mark.parametrize("version", ["v4", "v5"])
def test_the_robots_are_stepped_with_everything_that_is_faster(name, version):
    plain: Any = gymnasium.make(f"{name}-{version}").unwrapped
    model = tuned(plain.fullpath, plain.model)
    pairs = contact_pairs(plain.model)
    assert pairs
    assert model.npair == len(pairs)
    assert not model.geom_contype.any()
    assert model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_ISLAND


def test_a_model_that_would_lose_bits_is_stepped_as_it_is_written(monkeypatch, caplog):
    plain: Any = gymnasium.make("Hopper-v5").unwrapped
    pairs = contact_pairs(plain.model) or []
    foot = plain.model.geom("foot_geom").id
    fewer = [pair for pair in pairs if pair != (0, foot)]  # it falls through the floor
    assert len(fewer) == len(pairs) - 1
    monkeypatch.setattr("workers.physics.contact_pairs", lambda _: fewer)
    assert tuned(plain.fullpath, plain.model) is plain.model
    assert "hopper.xml keeps its bits only as it is written" in caplog.text


TOUCHY = """
<mujoco>
  <worldbody>
    <geom type="plane" size="5 5 1" friction="0.3" priority="2"/>
    <body pos="0 0 1"><freejoint/><geom size="0.2" margin="0.01" gap="0.002" condim="{condim}"/>
      <body pos="0.5 0 0"><joint type="hinge"/><geom size="0.1" solref="0.05 1" condim="4"/>
        <body pos="0.4 0 0"><joint type="slide"/><geom type="box" size="0.1 0.2 0.1"/></body>
      </body>
    </body>
    <body name="last" pos="0.1 0 1.5"><freejoint/><geom size="0.2" solmix="3" condim="6"/></body>
    <body name="post" pos="0.6 0.1 0.3"><geom type="box" size="0.1 0.1 0.3"/></body>
  </worldbody>
  <contact><exclude body1="last" body2="world"/></contact>
</mujoco>
"""


def steps_alike(path, model_of, steps=600):
    """Step a file's model as it is written and as `model_of` makes it; how much it touched."""
    plain = mujoco.MjModel.from_xml_path(str(path))
    model = model_of(plain)
    one, other = mujoco.MjData(plain), mujoco.MjData(model)
    touched = 0
    for _ in range(steps):
        mujoco.mj_step(plain, one)
        with WithoutTimer():
            mujoco.mj_step(model, other)
        touched += one.ncon
        assert one.qpos.tobytes() == other.qpos.tobytes()
        assert one.qvel.tobytes() == other.qvel.tobytes()
    return touched


@pytest.mark.parametrize("condim", [1, 3, 6])
def test_pairs_are_mixed_as_the_engine_mixes_them(tmp_path, monkeypatch, condim):
    path = tmp_path / "touchy.xml"
    path.write_text(TOUCHY.format(condim=condim))
    monkeypatch.setattr("workers.physics._is_gymnasiums", lambda _: True)

    def model_of(plain):
        model = tuned(str(path), plain)
        assert model.npair > 0
        return model

    assert steps_alike(path, model_of) > 100


def test_a_file_of_ones_own_keeps_its_broad_phase(tmp_path):
    path = tmp_path / "touchy.xml"
    path.write_text(TOUCHY.format(condim=3))

    def model_of(plain):
        model = tuned(str(path), plain)
        assert model.npair == 0
        return model

    assert steps_alike(path, model_of) > 100


def test_the_timer_is_back_after_stepping():
    hopper: Any = gymnasium.make("Hopper-v5").unwrapped
    data = mujoco.MjData(hopper.model)

    def timed():
        mujoco.mj_step(hopper.model, data)
        return data.timer[int(mujoco.mjtTimer.mjTIMER_STEP)].number

    before = timed()
    with WithoutTimer():
        pass
    assert timed() == before + 1
