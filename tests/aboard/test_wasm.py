"""The page of the documentation in node: its module drives as Python does, and protection holds by hand."""

import json
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from metropilot.aboard import find_zig, trace_driver, write_driver
from metropilot.drivers import LearnedDriver
from metropilot.errors import InputError
from metropilot.policy import Policy, in_precision, load_driving_policy, shipped_policy
from metropilot.railway import load_line, load_trainset
from metropilot.sim import Rollout, Run

PAGE = Path(__file__).parents[2] / "docs" / "assets" / "drive.html"
needs_node = pytest.mark.skipif(shutil.which("node") is None, reason="needs node")
DRIVE = """
const bytes = Uint8Array.from(atob(MODULE), (c) => c.charCodeAt(0));
const driver = await load(bytes.buffer);
const scheduled_s = SECTIONS[0].scheduled_s;
driver.reset(0);
const automatic = [];
let overruled = 0;
while (automatic.length < 400) {
  overruled += driver.step({ ...driver.plant(), scheduled_s }).level > 0;
  driver.move();
  automatic.push(driver.plant().position_m);
}
// full traction by hand, all the way
driver.reset(0);
let excess = -1, highest = 0;
for (let k = 0; k < 900; k++) {
  const answer = driver.supervise({ ...driver.plant(), scheduled_s }, 1);
  driver.move();
  const { position_m, speed_mps } = driver.plant();
  highest = Math.max(highest, speed_mps);
  excess = Math.max(excess, speed_mps - driver.permitted(0, position_m));
}
driver.reset(0);
const lost = driver.step({ ...driver.plant(), speed_mps: NaN, scheduled_s });
let refused = "";
try { driver.reset(SECTIONS.length); } catch (error) { refused = error.message; }
console.log(JSON.stringify({ automatic, overruled, excess, highest, interventions: driver.interventions(),
  lost, refused, sections: SECTIONS, imports: WebAssembly.Module.imports(new WebAssembly.Module(bytes)) }));
"""


def drive_in_node(page, folder):
    """Answer of the script of a page to a drive in node."""
    script = page.read_text(encoding="utf-8").split('<script type="module">')[1].split("const bytes")[0]
    module = re.search(r'atob\("([^"]+)"\)', page.read_text(encoding="utf-8"))[1]
    (folder / "drive.mjs").write_text(script + DRIVE.replace("MODULE", json.dumps(module)))
    done = subprocess.run(["node", "drive.mjs"], cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@needs_node
def test_the_page_of_the_documentation_drives_as_python_does(tmp_path):
    """If this fails, driver or protection have changed: write the page anew, by the command that it names."""
    found = drive_in_node(PAGE, tmp_path)
    loaded = load_driving_policy(shipped_policy("ppo"))
    policy = loaded.policy.policy
    exact = Policy(policy.spec, in_precision(policy.params, np.float64))
    section = load_line("yizhuang").section("RJ", "WYJ")
    scheduled_s = found["sections"][0]["scheduled_s"]
    rollout = Rollout(
        Run(section, load_trainset("dkz32", "AW2"), float(scheduled_s)),
        LearnedDriver(exact, loaded.interface),
    )
    for position_m in found["automatic"]:
        rollout.advance()
        assert abs(position_m - float(rollout.state.plant.position_m)) < 1e-6
    assert found["overruled"] == 0
    assert found["imports"] == []


@needs_node
def test_protection_holds_whoever_has_the_lever(tmp_path):
    found = drive_in_node(PAGE, tmp_path)
    limits_mps = load_line("yizhuang").section("RJ", "WYJ").limit_mps.at(np.arange(0.0, 1280.0))
    assert 0.9 * limits_mps.max() < found["highest"] <= limits_mps.max()
    assert found["excess"] < 0.5
    assert found["lost"]["emergency"] is True
    assert "allowed 0 to 0" in found["refused"]


def test_the_page_loads_nothing():
    text = re.sub(r'atob\("[^"]+"\)|^//.*$', "", PAGE.read_text(encoding="utf-8"), flags=re.MULTILINE)
    assert not re.search(r"https?://|src=|href=|fetch\(|import\b", text)


def test_webassembly_is_written_where_there_is_a_compiler(tmp_path):
    try:
        compiler = find_zig()
    except InputError as missing:
        pytest.skip(str(missing))
    loaded = load_driving_policy(shipped_policy("ppo"))
    program = trace_driver(
        "ppo", loaded, [load_line("yizhuang").section("RJ", "WYJ")], load_trainset("dkz32", "AW2")
    )
    report = write_driver(program, tmp_path, compiler=compiler)
    assert {"ppo.wasm", "ppo.mjs", "ppo.html", "ppo.c"} <= set(report.files)
    assert (tmp_path / "ppo.wasm").stat().st_size < 500_000
    if shutil.which("node"):
        assert drive_in_node(tmp_path / "ppo.html", tmp_path)["overruled"] == 0
