import json

from dftc_rt.cli.robots import robots


def test_json_is_one_object_and_nothing_else(capsys):
    assert robots(json=True) == 0
    out, err = capsys.readouterr()
    found = {robot["name"]: robot for robot in json.loads(out)["robots"]}
    assert {"arm2", "panda", "pendulums", "pendulums_physical", "ur5", "ur10"} <= set(found)
    assert found["panda"]["dof"] == 7
    assert found["panda"]["joints"][3] == {
        "name": "panda_joint4", "torque_limit_nm": 87.0, "bus": "can1", "node_id": 4,
    }  # fmt: skip
    assert found["panda"]["locked"] == ["panda_finger_joint1", "panda_finger_joint2"]
    assert err == ""
    assert found["pendulums"]["plant"] == "pendulums"
    assert found["pendulums"]["joints"][1]["name"] == "pendulum2"
    assert found["arm2"]["plant"] is found["panda"]["plant"] is None


def test_a_narrow_table_leaves_every_name_whole(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    assert robots() == 0
    out = capsys.readouterr().out
    assert "…" not in out
    for name in ("pendulums_physical", "shoulder_lift_joint", "panda_joint7", "[zhao2017]"):
        assert name in out


def test_the_table_shows_every_joint_and_no_markup_is_lost(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    assert robots() == 0
    out, _ = capsys.readouterr()
    assert "wrist_3_joint" in out
    assert "[zhao2017]" in out
