"""TTOBench tracks, trains and journeys: what is read, what is kept, what comes back."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.railway import samples

from metropilot.errors import InputError
from metropilot.physics import brake_available_n, vehicle_arrays
from metropilot.railway import (
    Couplers,
    Curve,
    SafeBraking,
    Trainset,
    Tunnel,
    export_ttobench,
    import_file,
    load_journey,
    load_line,
    load_trainset,
)

SHARED = Path(__file__).resolve().parents[2].parent / "shared" / "ttobench"
needs_shared = pytest.mark.skipif(
    not SHARED.is_dir(), reason="the benchmark's files are not beside the checkout"
)


@pytest.fixture
def save(tmp_path):
    def write(document, name="file.json"):
        path = tmp_path / name
        path.write_text(json.dumps(document), encoding="utf-8")
        return path

    return write


class TestTrack:
    def test_units_are_the_files(self, save):
        line = load_line(save(samples.track()))
        assert [s.position_m for s in line.stations] == [0.0, 1250.0, 3000.0]
        assert line.limit_mps.from_m.tolist() == [0.0, 500.0]
        assert line.limit_mps.value.tolist() == [15.0, 20.0]
        assert line.gradient_permil.from_m.tolist() == [0.0, 700.0]
        assert line.altitude_m == 200.0

    def test_stops_become_stations(self, save):
        line = load_line(save(samples.track()))
        assert [(s.code, s.name) for s in line.stations] == [
            ("S1", "Stop 1"),
            ("S2", "Stop 2"),
            ("S3", "Stop 3"),
        ]
        assert line.section("S3", "stop 2").length_m == 1750.0
        assert line.id == "toy_track"

    def test_clothoids_and_tunnels(self, save):
        line = load_line(save(samples.track()))
        assert line.curves == (
            Curve(0.0, 0.0, 0.0),
            Curve(100.0, 0.0, 1 / 500.0),
            Curve(150.0, 1 / 500.0, 1 / 500.0),
            Curve(400.0, 1 / -300.0, 1 / -300.0),
        )
        assert line.tunnels == (Tunnel(900.0, 250.0, 40.0),)

    def test_what_has_no_effect_is_kept_and_named(self, save):
        line = load_line(save(samples.track()))
        assert line.unused == ("ETCS braking data", "platforms")
        assert line.extra["platforms"] == {"unit": "m", "values": [120, 120, 120]}
        assert "TTOBench v1.5, toy_track, nobody" in line.source["speed_limits"]

    @pytest.mark.parametrize("version", ["1.1", "1.2", "1.3", "1.4"])
    def test_older_and_barer_versions(self, save, version):
        old = samples.track()
        old["metadata"] = {"id": "old", "library version": f"TTOBench v{version}"}
        for key in ("altitude", "gradients", "curvatures", "tunnels", "ETCS braking data", "platforms"):
            del old[key]
        line = load_line(save(old))
        assert (line.curves, line.tunnels, line.altitude_m, line.unused) == ((), (), 0.0, ())
        assert float(line.gradient_permil.at(1000.0)) == 0.0
        assert f"v{version}" in line.source["stations"]

    def test_without_metadata_the_file_names_it(self, save):
        bare = samples.track()
        del bare["metadata"]
        assert load_line(save(bare, "somewhere.json")).id == "somewhere"


class TestTrain:
    def test_numbers(self, save):
        trainset = load_trainset(save(samples.train()))
        assert (trainset.mass_kg, trainset.rotating_fraction, trainset.length_m) == (160e3, 0.08, 80.0)
        np.testing.assert_allclose(trainset.traction.at(np.array([0.0, 10.0, 25.0])), [190e3, 190e3, 100e3])
        np.testing.assert_allclose(trainset.electric_brake.at(np.array([0.0, 20.0])), [150e3, 100e3])
        assert trainset.friction_brake_n == 160e3
        assert trainset.davis.newtons(1.0) == pytest.approx((2000.0, 64.8, 9.0))
        assert (trainset.max_acceleration_mps2, trainset.max_deceleration_mps2) == (math.inf, 1.1)
        assert float(trainset.efficiency_traction.value[0, 0]) == 0.88
        assert float(trainset.efficiency_braking.value[0, 0]) == 0.85
        assert trainset.receptivity == 1.0
        assert trainset.couplers == Couplers(vehicles=4)
        np.testing.assert_allclose(trainset.tunnel_n_per_mps2, [(24.0, 12.96), (40.0, 6.48)])
        assert trainset.max_speed_mps == 120 / 3.6

    def test_full_service_braking_is_the_declared_deceleration_and_not_every_brake_there_is(self, save):
        document = samples.train()
        document["max pn braking force"]["value"] = 1600.0
        trainset = load_trainset(save(document))
        assert trainset.service_deceleration_mps2 == trainset.max_deceleration_mps2 == 1.1
        vehicle = vehicle_arrays(trainset)
        full = float(brake_available_n(vehicle, 5.0)) / trainset.effective_mass_kg
        assert full == pytest.approx(1.1)

    @pytest.mark.parametrize(("friction_kn", "service_mps2"), [(1600.0, 1.0), (0.0, math.inf)])
    def test_where_none_is_declared_strong_brakes_are_used_up_to_an_assumed_rate(
        self, save, tmp_path, friction_kn, service_mps2
    ):
        document = samples.train()
        del document["max deceleration"]
        document["max pn braking force"]["value"] = friction_kn
        document["max reg braking force"]["value"] = 170.0  # On 172.8 t: 0.98 m/s2.
        trainset = load_trainset(save(document))
        assert trainset.service_deceleration_mps2 == service_mps2
        assert any("service braking assumed" in note for note in trainset.notes) == (service_mps2 == 1.0)
        assert export_ttobench(trainset, tmp_path / "back.json") == ()
        assert import_file(tmp_path / "back.json") == trainset

    def test_the_etcs_block_is_what_protection_relies_on(self, save):
        trainset = load_trainset(save(samples.train()))
        # Lowest emergency rate 1.0 m/s2, times 0.9 on a dry rail; 2 s of build-up of which 0.5 s cut-off.
        assert trainset.safe_braking == SafeBraking(0.9, 0.7, 0.5, 1.5)
        assert set(trainset.unused) == {
            "num seats",
            "ETCS braking data.K_wet_rst",
            "ETCS braking data.T_bs",
            "ETCS braking data.v_uncertainty",
        }

    def test_without_it_the_rates_are_assumed_and_said_to_be(self, save):
        document = samples.train()
        del document["ETCS braking data"]
        trainset = load_trainset(save(document))
        # At 120 km/h: 60 kN electric and 160 kN friction on 172.8 t, above the usual 1 m/s2.
        assert trainset.safe_braking == SafeBraking(1.2, 1.0)
        assert "assumed" in trainset.notes[0]

    def test_losses_over_load_and_speed_become_an_efficiency(self, save):
        document = samples.train()
        rows = [[p, v, 10.0 + p + v] for p in (0, 50, 100) for v in (0.0, 36.0, 72.0)]
        units = {"load": "%", "velocity": "km/h", "losses": "kW"}
        document["efficiency traction"] = {"units": units, "values": rows}
        document["efficiency reg brake"] = {"units": units, "values": rows}
        trainset = load_trainset(save(document))
        map_ = trainset.efficiency_traction
        assert (map_.speed_mps.tolist(), map_.effort_share.tolist()) == ([10.0, 20.0], [0.5, 1.0])
        # Half load at 10 m/s: 0.5 * 190 kN * 10 m/s = 950 kW at the wheel, losses 96 kW.
        assert map_.value[0, 0] == pytest.approx(950 / 1046)
        assert trainset.efficiency_braking.value[0, 0] == pytest.approx((750 - 96) / 750)

    def test_a_map_of_losses_must_be_full(self, save):
        document = samples.train()
        units = {"load": "%", "velocity": "km/h", "losses": "kW"}
        document["efficiency traction"] = {"units": units, "values": [[50, 36, 9], [100, 72, 9]]}
        with pytest.raises(InputError, match="not a full grid"):
            load_trainset(save(document))


def test_journey(save):
    journey = load_journey(save(samples.journey()))
    assert (journey.id, journey.line_id) == ("toy_journey", "toy_track")
    start, middle, end = journey.points
    assert (start.is_stop, middle.is_stop, end.is_stop) == (True, False, True)
    assert (middle.position_m, middle.earliest_s, middle.latest_s) == (1250.0, None, 120.0)
    assert (middle.slowest_mps, middle.fastest_mps) == (5.0, None)


class TestExport:
    @pytest.mark.parametrize("document", [samples.track, samples.train, samples.journey])
    def test_nothing_is_lost_on_the_way_through(self, save, tmp_path, document):
        before = import_file(save(document()))
        assert export_ttobench(before, tmp_path / "back.json") == ()
        assert import_file(tmp_path / "back.json") == before
        written = json.loads((tmp_path / "back.json").read_text(encoding="utf-8"))
        assert set(written) == set(document())
        assert written["metadata"] == document()["metadata"]

    def test_a_map_of_losses_comes_back(self, save, tmp_path):
        document = samples.train()
        units = {"load": "%", "velocity": "km/h", "losses": "kW"}
        rows = [[p, v, 5.0] for p in (50, 100) for v in (36.0, 72.0)]
        document["efficiency traction"] = {"units": units, "values": rows}
        before = import_file(save(document))
        export_ttobench(before, tmp_path / "back.json")
        assert import_file(tmp_path / "back.json") == before

    def test_what_the_format_has_no_place_for_is_named(self, tmp_path):
        line = load_line("yizhuang")
        lost = export_ttobench(line, tmp_path / "line.json")
        assert {"stations.name", "planned_forward_s", "dwell_s"} <= set(lost)
        back = load_line(tmp_path / "line.json")
        assert (back.limit_mps, back.gradient_permil, back.curves) == (
            line.limit_mps,
            line.gradient_permil,
            line.curves,
        )

    def test_an_effort_curve_is_never_approximated(self, tmp_path):
        with pytest.raises(InputError, match=r"cannot express.*2 pieces"):
            export_ttobench(load_trainset("dkz32"), tmp_path / "train.json")
        assert not (tmp_path / "train.json").exists()

    def test_the_catalogues_benchmark_trainset_goes_out_and_in(self, tmp_path):
        trainset = load_trainset("cn_beijing_subway")
        export_ttobench(trainset, tmp_path / "train.json")
        back = load_trainset(tmp_path / "train.json")
        assert isinstance(back, Trainset)
        same = ("loads", "davis", "traction", "electric_brake", "efficiency_traction", "efficiency_braking")
        assert all(getattr(back, name) == getattr(trainset, name) for name in same)

    def test_a_json_file_it_must_be(self, tmp_path):
        with pytest.raises(InputError, match=r"ending in \.json"):
            export_ttobench(load_trainset("cn_beijing_subway"), tmp_path / "train.toml")


@needs_shared
class TestBenchmarkFiles:
    @pytest.mark.parametrize("path", sorted(SHARED.glob("*/*.json")), ids=lambda p: p.stem)
    def test_every_file_reads_and_comes_back(self, path, tmp_path):
        thing = import_file(path)
        assert thing.id == path.stem
        assert export_ttobench(thing, tmp_path / path.name) == ()
        assert import_file(tmp_path / path.name) == thing

    def test_the_catalogue_line_is_the_file_but_for_one_stop(self):
        theirs = load_line(SHARED / "tracks" / "CN_Songjiazhuang_Yizhuang.json")
        ours = load_line("yizhuang-ttobench")
        assert (theirs.limit_mps, theirs.gradient_permil) == (ours.limit_mps, ours.gradient_permil)
        pairs = zip(theirs.stations, ours.stations, strict=True)
        differ = [(a.position_m, b.position_m) for a, b in pairs if a.position_m != b.position_m]
        assert differ == [(9274.0, 9247.0)]

    def test_the_catalogue_trainset_is_the_file(self):
        theirs = load_trainset(SHARED / "trains" / "CN_Beijing_Subway.json")
        ours = load_trainset("cn_beijing_subway")
        same = {
            name: getattr(theirs, name) for name in ("id", "name", "source", "notes", "extra", "safe_braking")
        }
        assert replace(ours, **same) == theirs

    def test_a_clothoid_of_the_swiss_track(self):
        curves = load_line(SHARED / "tracks" / "CH_StGallen_Wil.json").curves
        assert curves[1] == Curve(49.6, 1 / 502.0, 1 / 3570.0)
        assert curves[5].curvature_end_per_m == 0.0
        assert min(c.curvature_start_per_m for c in curves) < 0
