"""Good logs of the other formats, as small as they can be: texts, tables, MATLAB, folders."""

import gzip
import io
import json

import numpy as np

from fuzzing.case import Case, single

STEP = 2 * np.pi / 4096
MAP = b"""
[time]
column = "t"
unit = "s"
[[signal]]
column = "q_*"
signal = "position"
unit = "deg"
[[signal]]
column = "cmd_*"
signal = "goal"
unit = "rad"
[[signal]]
column = "v"
signal = "supply_voltage"
unit = "mV"
[[signal]]
column = "list"
signal = "current"
unit = "A"
joints = ["a", "b"]
[joints]
knee = "left_knee"
"""
TOPICS = b"""
[time]
field = "header.stamp"
unit = "ns"
[[signal]]
topic = "/joint_*"
field = ["position", "q"]
joints = "name"
signal = "position"
unit = "rad"
[[signal]]
topic = "Control.*"
field = "positions"
signal = "goal"
unit = "tick"
ticks_per_turn = 4096
zero = 2048
scale = -1
"""


def texts() -> dict[str, list[Case]]:
    """By format."""
    t = [0.01 * i for i in range(12)]
    bam = {
        "mass": 0.5, "length": 0.15, "kp": 16, "vin": 15.0, "motor": "mx106", "trajectory": "sin", "dt": 0.01,
        "entries": [
            {"timestamp": one, "position": 0.1, "speed": 0.0, "goal_position": one, "torque_enable": True,
             "input_volts": 15.0, "temp": 30, "load": 0.1}
            for one in t
        ],
    }  # fmt: skip
    dynaban = "StartOfNewTest 0\n\nTime Command Position Speed\n9 3000 4094 3000\n19 3000 4095 20\n29 3000 1 20\n" * 2
    miuzei = {
        "dataset": "real", "config": {"action_hz": 50},
        "data": [{"type": "step", "targets": ["kp"], "actions": [0.0, 0.5, 0.5], "sensor_data": [0.0, 0.0, 0.25]}] * 2,
    }  # fmt: skip
    chirp = {
        "config": {"kp": 150.0, "kd": 8.0, "actuator_id": 44},
        "data": [
            {"time_since_start": one, "position": 45.0, "commanded_position": 90.0, "torque": 1.0, "freq": 0.2}
            for one in t
        ],
    }
    beside = json.dumps({"joint_name_to_metadata": {"knee": {"id": 44, "actuator_type": "Robstride_04"}}}).encode()
    squat = [
        {"time": one, "actuator_id": i, "position": 45.0, "commanded_position": 90.0, "velocity": 180.0}
        for one in t
        for i in (31, 44)
    ]
    harold = "timestamp,timestamp_ms,pos_hip,pos_knee,cmd_pos_hip,cmd_pos_knee,load_hip,load_knee,bus_voltage_v,mode\n"
    harold += "".join(
        f"2026-01-02T05:02:24.7{i:02d},{100 + 10 * i},0.1,0.2,0.3,0.4,8,9,12.1,POLICY\n" for i in range(9)
    )
    upkie = [
        {
            "time": 100.0 + one,
            "action": {"servo": {"hip": {"position": 0.1, "velocity": 0.0}, "wheel": {"position": None}}},
            "observation": {
                "time": 100.0 + one, "servo": {"hip": {"position": 0.1, "velocity": 0.0}},
                "imu": {"angular_velocity": [0.1, 0.2, 0.3], "orientation": [1.0, 0.0, 0.0, 0.0]},
            },
        }
        for one in t
    ]  # fmt: skip
    rostopic = "%time,field.header.seq,field.header.stamp," + ",".join(f"field.angular_velocity.{x}" for x in "xyz")
    rostopic += "".join(f"\n{EPOCH + i * 10**7 + 5},{i},{EPOCH + i * 10**7},0.1,0.2,0.3" for i in range(12)) + "\n"
    state = "%time,field.header.stamp,field.name0,field.name1,field.position0,field.position1"
    state += "".join(f"\n{EPOCH + i * 10**7 + 5},{EPOCH + i * 10**7},a,b,0.1,0.2" for i in range(12)) + "\n"
    imu = "".join(f"{0.002 * i} -0.5 0 2.0 0 0.2 -0.5\n" for i in range(12))
    found = {
        "bam": [
            single(json.dumps(bam).encode(), "a.json"),
            single(gzip.compress(json.dumps(bam).encode()), "a.json.gz"),
        ],
        "dynaban": [single(dynaban.encode(), "a.txt")],
        "miuzei": [single(json.dumps(miuzei).encode(), "a.json")],
        "robstride": [Case({"real_a.json": json.dumps(chirp).encode(), "metadata.json": beside}, "real_a.json")],
        "kbot": [Case({"kbot_a.json": json.dumps(squat).encode(), "metadata.json": beside}, "kbot_a.json")],
        "harold": [single(harold.encode(), "a.csv")],
        "upkie": [single("\n".join(json.dumps(one) for one in upkie).encode(), "a.jsonl")],
        "rostopic_csv": [single(rostopic.encode(), "a.csv"), single(state.encode(), "a.csv")],
        "imu_on_axis": [single(imu.encode(), "a.dat"), single(gzip.compress(imu.encode()), "a.dat.gz")],
        "jandi": [_jandi()],
        "emps": [single(_matlab(packed), "a.mat") for packed in (True, False)],
    }
    return {**found, **_tables()}


EPOCH = 1_700_000_000 * 10**9


def _jandi() -> Case:
    names = "tx_end_ns rx_end_ns acquisition_kind q_present_rad present_position_tick dq_present_rad_s current_A_joint "
    names += "pwm_percent input_voltage_V temperature_C realtime_tick_ms hardware_error"
    rows = [names.replace(" ", ",")]
    goals = ["goal_rad,goal_tick,tx_end_ns"]
    for i in range(40):
        sent = 10**12 + 10_000_000 * i
        rows.append(
            f"{sent},{sent + 2_000_000},state,{-5 * STEP},2053,0.1,0.2,25.0,12.5,38,{(32_700 + 10 * i) % 32768},"
        )
        goals.append(f"0.01,2041,{sent}")
    facts = {
        "valid_flag": True, "trajectory": "step", "model_number": 321, "bench": {"bare_horn": True},
        "config_snapshot": {"resolved": {"hardware": {"direction": -1, "zero_tick": 2048}}},
        "register_readback": {"operating_mode": 5, "position_p_gain": 350},
    }  # fmt: skip
    files = {
        "telemetry.csv": "\n".join(rows).encode(),
        "command_events.csv.gz": gzip.compress("\n".join(goals).encode()),
        "metadata.json": json.dumps(facts).encode(),
    }
    return Case(files, "")


def _matlab(packed: bool) -> bytes:
    import scipy.io

    t = 0.001 * np.arange(40)[:, None]
    values = {"t": t, "qm": np.sin(t), "qg": np.sin(t), "vir": np.cos(t), "gtau": 35.0, "kp": 160.0, "kv": 243.0}
    file = io.BytesIO()
    scipy.io.savemat(file, values, do_compression=packed)
    return file.getvalue()


def _tables() -> dict[str, list[Case]]:
    import pandas as pd

    t = np.arange(30) / 100
    frame = pd.DataFrame({"t": t, "q_knee": np.sin(t), "q_hip": np.cos(t), "cmd_knee": t, "cmd_hip": -t, "v": 12e3})
    table, arrow, packed = io.BytesIO(), io.BytesIO(), io.BytesIO()
    frame.to_csv(table, index=False)
    frame.to_parquet(arrow)
    lists = io.BytesIO()
    frame.assign(list=[[0.1, 0.2]] * 30).to_parquet(lists)
    whole = frame.to_numpy()
    columns = {"t": whole[:, 0], "q_knee": whole[:, 1], "cmd_knee": whole[:, 3], "v": whole[:, 5]}
    np.savez_compressed(packed, **columns)
    stored = io.BytesIO()
    np.savez(stored, **columns)
    semicolons = table.getvalue().replace(b",", b";")
    return {
        "csv": [single(one, "a.csv") for one in (table.getvalue(), semicolons, gzip.compress(table.getvalue()))],
        "parquet": [single(one.getvalue(), "a.parquet") for one in (arrow, lists)],
        "npz": [single(packed.getvalue(), "a.npz"), single(stored.getvalue(), "a.npz")],
        "map": [single(MAP, "a.toml"), single(TOPICS, "a.toml")],
    }
