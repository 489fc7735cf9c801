"""Hostile MuJoCo models and YAML."""

from collections.abc import Callable

from fuzzing.case import Case, single
from fuzzing.targets_sysid import MODELS

BODY = '<worldbody><body name="b"><freejoint/><geom size="0.1"/></body></worldbody>'
SECRET = b"frasa-secret-0123456789"


def _model(inside: str, head: str = "") -> bytes:
    return f'{head}<mujoco model="m">{inside}</mujoco>'.encode()


def _laughs() -> str:
    lines = "".join(f'<!ENTITY l{i} "{f"&l{i - 1};" * 10}">' for i in range(1, 10))
    return f'<!DOCTYPE mujoco [<!ENTITY l0 "lol">{lines}]>'


def models() -> list[Case]:
    """XML that reads elsewhere, or asks for more than there is."""
    texts = {
        "billion laughs": _model(f'{BODY}<custom><text name="t" data="&l9;"/></custom>', _laughs()),
        "external entity": _model(
            f'{BODY}<custom><text name="t" data="&x;"/></custom>',
            '<!DOCTYPE mujoco [<!ENTITY x SYSTEM "file:///etc/hostname">]>',
        ),
        "external document type": _model(BODY, '<!DOCTYPE mujoco SYSTEM "http://127.0.0.1:9/x.dtd">'),
        "include climbs": _model(f'{BODY}<include file="../../../../../../etc/passwd"/>'),
        "include absolute": _model(f'{BODY}<include file="/etc/passwd"/>'),
        "include a device": _model(f'{BODY}<include file="/dev/zero"/>'),
        "include itself": _model(f'{BODY}<include file="m.xml"/>'),
        "include nothing": _model(f"{BODY}<include/>"),
        "include a folder": _model(f'{BODY}<include file="."/>'),
        "mesh climbs": _model(f'<asset><mesh name="x" file="../secret.stl"/></asset>{BODY}'),
        "mesh a device": _model(f'<asset><mesh name="x" file="/dev/zero" content_type="model/stl"/></asset>{BODY}'),
        "mesh of a folder outside": _model(
            f'<compiler meshdir="/dev"/><asset><mesh name="x" file="zero" content_type="model/stl"/></asset>{BODY}'
        ),
        "texture climbs": _model(f'<asset><texture name="x" type="2d" file="../../x.png"/></asset>{BODY}'),
        "height field climbs": _model(f'<asset><hfield name="x" size="1 1 1 1" file="../../x.png"/></asset>{BODY}'),
        "skin climbs": _model(f'<asset><skin name="x" file="../../x.skn"/></asset>{BODY}'),
        "model climbs": _model(f'<asset><model name="x" file="../../x.xml"/></asset>{BODY}'),
        "plugin": _model(f'<extension><plugin plugin="x.y"/></extension>{BODY}'),
        "memory": _model(f'<size memory="900G"/>{BODY}'),
        "nstack": _model(f'<size nstack="2000000000"/>{BODY}'),
        "nuser": _model(f'<size nuser_body="2000000000"/>{BODY}'),
        "nuserdata": _model(f'<size nuserdata="2000000000"/>{BODY}'),
        "nkey": _model(f'<size nkey="2000000000"/>{BODY}'),
        "height field": _model(f'<asset><hfield name="x" size="1 1 1 1" nrow="60000" ncol="60000"/></asset>{BODY}'),
        "texture": _model(
            f'<asset><texture name="x" type="2d" builtin="flat" width="60000" height="60000"/></asset>{BODY}'
        ),
        "custom number": _model(f'<custom><numeric name="x" size="2000000000"/></custom>{BODY}'),
        "replicate": _model('<worldbody><replicate count="100000000"><geom size="0.1"/></replicate></worldbody>'),
        "replicate of replicates": _model(
            "<worldbody>" + '<replicate count="100">' * 4 + '<geom size="0.1"/>' + "</replicate>" * 4 + "</worldbody>"
        ),
        "composite": _model(
            '<worldbody><composite type="cable" curve="s" count="100000000 1 1" size="1">'
            '<geom type="capsule" size="0.1"/></composite></worldbody>'
        ),
        "flex": _model(
            '<worldbody><body><flexcomp name="x" type="grid" count="9000 9000 9000" spacing="1 1 1" radius="0.1"/>'
            "</body></worldbody>"
        ),
        "history": _model(
            '<worldbody><body><joint name="j"/><geom size="0.1"/></body></worldbody>'
            '<actuator><position joint="j" delay="0.01" nsample="2000000000"/></actuator>'
        ),
        "history of a sensor": _model(
            '<worldbody><body><joint name="j"/><geom size="0.1"/></body></worldbody>'
            '<sensor><jointpos joint="j" delay="0.01" nsample="2000000000"/></sensor>'
        ),
        "nested": _model("<worldbody>" + "<body>" * 20_000 + "</body>" * 20_000 + "</worldbody>"),
        "nested tags": b"<a>" * 500_000,
        "a long attribute": _model(f'{BODY}<custom><text name="t" data="{"x" * 30_000_000}"/></custom>'),
        "many geoms": _model("<worldbody>" + '<geom size="0.1"/>' * 300_000 + "</worldbody>"),
        "not UTF-8": b"\xff\xfe<mujoco/>",
        "empty": b"",
        "text": b"hello",
        "another root": b"<html/>",
        "URDF": b'<robot name="x"><link name="a"/></robot>',
        "timestep": _model(f'<option timestep="1e-300"/>{BODY}'),
    }
    fine = ("timestep", "URDF", "include nothing")
    found = [
        Case({"m.xml": one, "secret.stl": SECRET}, "m.xml", note, refuse=note not in fine)
        for note, one in texts.items()
    ]
    return [*found, Case({"m.xml": None}, "m.xml", "a folder", refuse=True)]


def yaml_texts(name: str, good: bytes) -> list[Case]:
    """YAML that grows, nests, executes, or says a thing twice."""
    laughs = b"a: &a [x, x, x, x, x, x, x, x, x]\n" + b"".join(
        b"%c: &%c [%s]\n" % (98 + i, 98 + i, b", ".join([b"*%c" % (97 + i)] * 9)) for i in range(9)
    )
    merge = b"a: &a {x: 1}\n" + b"".join(b"b%d: {<<: [%s]}\n" % (i, b", ".join([b"*a"] * 500)) for i in range(50))
    made = {
        "billion laughs": laughs,
        "laughs behind": good + laughs,
        "merges": merge,
        "itself": b"&a [*a]\n",
        "nested": b"[" * 20_000,
        "nested mappings": b"{a: " * 5_000,
        "nested lines": b"".join(b" " * i + b"a:\n" for i in range(900)),
        "executes": b"!!python/object/apply:os.system ['touch frasa-fuzz-was-here']\n",
        "executes inside": good + b"\nx: !!python/name:os.system\n",
        "a key twice": good + b"\n" + good,
        "many keys": b"".join(b"k%d: 1\n" % i for i in range(60_000)),
        "huge": b"x: '" + b"a" * 20_000_000 + b"'\n",
        "many numbers": b"[" + b"1.5, " * 2_000_000 + b"1]",
        "a number of a million digits": b"a: 0x" + b"f" * 1_000_000,
        "sexagesimal": b"a: " + b"9:" * 20_000 + b"9",
        "binary": b"a: !!binary " + b"A" * 500_000,
        "two documents": good + b"\n---\n" + good,
        "not UTF-8": b"\xff\xfe\xfa\x00",
        "empty": b"",
        "a date that is none": b"a: 2020-99-99\n",
        "tabs": b"\tschema: x\n",
        "a list for a key": b"? [1, 2]\n: 3\n",
    }
    found = [single(one, name, note, refuse=True) for note, one in made.items()]
    return [*found, Case({name: None}, name, "a folder", refuse=True)]


def _ranges() -> list[Case]:
    return yaml_texts("randomization.yaml", (MODELS / "randomization.yaml").read_bytes())


MADE: dict[str, Callable[[], list[Case]]] = {"model (MJCF)": models, "ranges (YAML)": _ranges}
