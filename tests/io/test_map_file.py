"""The map file: what is written comes back, the same map gives the same bytes, and others can open it."""

from __future__ import annotations

import json

import numpy as np
import pytest
from astropy.io import fits
from astropy.io.fits.scripts import fitscheck

from calibench.errors import BadInput
from calibench.io.map_file import encode_map, map_info, read_map, verify_map, write_map
from calibench.records import (
    DEFECT_FLAGS,
    IMAGE_LAYERS,
    CalibrationMap,
    Camera,
    Conditions,
    Intrinsics,
    Limit,
    PsfMap,
    Quantity,
    Verdict,
)

EVIDENCE = {
    "intrinsics/corner_xy_px": np.arange(24.0).reshape(2, 6, 2),
    "intrinsics/outlier": np.array([[True, False], [False, True]]),
    "intrinsics/view_file": np.array(["a.png", "größe µ\n.png"]),
    "dark/count": np.array([1, 2**63 + 1], dtype=np.uint64),
    "dark/bytes": np.array([-3, 5], dtype=np.int8),
    "dark/half": np.array([0.5, np.inf], dtype=np.float16),
    "dark/scalar_s": np.array(0.25),
    "dark/nothing": np.zeros((0, 3), dtype=np.float32),
    "dark/no_text": np.array([], dtype="U4"),
    "dark/big_endian": np.array([1.5, np.nan], dtype=">f8"),
}


@pytest.fixture(scope="module")
def full_map() -> CalibrationMap:
    """Every layer measured, every kind of evidence, text that is not ASCII."""
    rng = np.random.default_rng(7)
    w, h = 20, 12
    size = (w, h)
    lens = Intrinsics(model="brown5", fx_px=1416.7, fy_px=1417.1, cx_px=9.4, cy_px=5.6, image_size_px=size,
                      distortion=[-0.11, 0.2, 1e-4, -3e-4, 0.013], covariance=np.diag(rng.uniform(0.1, 1, 9)))
    psf = PsfMap(model="gaussian", degree=1, coefficients=rng.normal(size=(3, 3)), image_size_px=size,
                 centre="centroid of the Gaussian", measured_xy_px=rng.uniform(0, 10, (5, 2)), residual_rms_px2=0.01)
    limit = Limit(measurement="dark", quantity="read_noise_e", maximum=5.0, unit="e-", why="a star of 5 mag")
    return CalibrationMap(
        image_size_px=size,
        measured=frozenset([*IMAGE_LAYERS, "defects", "gain_dn_per_e", "saturation_dn", "intrinsics", "psf"]),
        **{name: rng.normal(1, 0.1, (h, w)).astype(np.float32) for name in IMAGE_LAYERS},
        defects=rng.choice(list(DEFECT_FLAGS.values()), (h, w)), gain_dn_per_e=0.103, saturation_dn=1023.0,
        intrinsics=lens, psf=psf, camera=Camera(name="Bänk camera", serial="007", pixel_size_um=6.0),
        conditions=Conditions(exposure_s=(0.01, 2.0), temperature_c=(19.5, 21.0), gain_setting=16.0, bit_depth=10,
                              date_obs=("2024-01-01T00:00:00", "2024-01-01T01:00:00"), camera="MT9V022"),
        quantities={"dark.read_noise_e": Quantity(name="read_noise_e", value=4.5, unit="e-", symbol="σ_d",
                                                  uncertainty=0.1, source="EMVA 1288 R4.0 Linear, 6.6"),
                    "dark.dsnu_1288_e": Quantity(name="dsnu_1288_e", value=None, unit="e-",
                                                 reason="the gain is unknown")},
        verdicts=(Verdict(limit=limit, status="pass", value=4.5, uncertainty=0.1, reason="4.5 e- is within the limit"),
                  Verdict(limit=limit, status="skipped", reason="not measured")),
        warnings=("dark: the temperature drifts",), evidence=EVIDENCE, inputs={"dark/d1.png": "ab" * 32},
        settings={"dark": {"hot_e_per_s": 20.0, "robust": True, "sizes": [3, 5]}},
        protocol_sha256="cd" * 32, software="calibench 0.1.0", created="2024-01-02T03:04:05Z")


@pytest.fixture
def map_path(tmp_path, full_map):
    path = tmp_path / "calibration.fits"
    write_map(path, full_map)
    return path


def test_everything_comes_back(map_path, full_map):
    back = read_map(map_path)
    for name in IMAGE_LAYERS:
        np.testing.assert_array_equal(getattr(back, name), getattr(full_map, name))
        assert getattr(back, name).dtype == np.float32 and getattr(back, name).dtype.isnative
    np.testing.assert_array_equal(back.defects, full_map.defects)
    for name in ("measured", "image_size_px", "gain_dn_per_e", "saturation_dn", "camera", "conditions", "quantities",
                 "inputs", "settings", "verdicts", "warnings", "protocol_sha256", "software", "created"):
        assert getattr(back, name) == getattr(full_map, name), name
    np.testing.assert_array_equal(back.intrinsics.parameters, full_map.intrinsics.parameters)
    np.testing.assert_array_equal(back.intrinsics.covariance, full_map.intrinsics.covariance)
    np.testing.assert_array_equal(back.psf.coefficients, full_map.psf.coefficients)
    np.testing.assert_array_equal(back.psf.measured_xy_px, full_map.psf.measured_xy_px)
    assert (back.psf.degree, back.psf.centre, back.psf.residual_rms_px2) == (1, "centroid of the Gaussian", 0.01)


@pytest.mark.parametrize("key", EVIDENCE)
def test_evidence_keeps_its_dtype_and_shape(map_path, key):
    back = read_map(map_path).evidence[key]
    assert (back.shape, back.dtype) == (EVIDENCE[key].shape, EVIDENCE[key].dtype.newbyteorder("="))
    np.testing.assert_array_equal(back, EVIDENCE[key])


def test_the_same_map_gives_the_same_bytes(full_map, map_path):
    assert encode_map(full_map) == map_path.read_bytes()
    assert encode_map(read_map(map_path)) == map_path.read_bytes()
    with fits.open(map_path) as hdus:  # the FITS library would put the time of writing there
        assert len({hdu.header.comments[card] for hdu in hdus for card in ("CHECKSUM", "DATASUM")}) == 1


def test_only_measured_layers_are_stored(tmp_path):
    path = tmp_path / "offset.fits"
    offset_dn = np.full((3, 4), 64.0)
    write_map(path, CalibrationMap(image_size_px=(4, 3), offset_dn=offset_dn, measured=frozenset(["offset_dn"])))
    with fits.open(path) as hdus:
        assert [hdu.name for hdu in hdus] == ["PRIMARY", "METADATA", "QUANTITIES", "VERDICTS", "INPUTS", "OFFSET_DN"]
    back = read_map(path)
    assert back.measured == {"offset_dn"} and np.all(back.response == 1) and np.isnan(back.gain_dn_per_e)


def test_fitscheck_accepts_the_file_and_only_the_undamaged_one(map_path):
    assert fitscheck.main([str(map_path), "--compliance"]) == 0
    content = bytearray(map_path.read_bytes())
    content[-5000] ^= 1
    map_path.write_bytes(content)
    assert fitscheck.main([str(map_path)]) == 1


def test_a_plain_fits_reader_understands_the_file(map_path, full_map):
    with fits.open(map_path, checksum=True) as hdus:
        hdus.verify("exception")
        assert all("CHECKSUM" in hdu.header and "DATASUM" in hdu.header for hdu in hdus)
        assert hdus["DEFECTS"].data.dtype == np.uint16
        assert [hdus["DEFECTS"].header[f"BIT{bit}"] for bit in range(len(DEFECT_FLAGS))] == list(DEFECT_FLAGS)
        assert hdus["QUANTITIES"].data["VALUE"][0] == 4.5 and np.isnan(hdus["QUANTITIES"].data["VALUE"][1])
        assert list(hdus["VERDICTS"].data["STATUS"]) == ["pass", "skipped"]
        assert list(hdus["INPUTS"].data["FILE"]) == ["dark/d1.png"]
        assert json.loads(hdus["METADATA"].data["JSON"][0])["camera"]["name"] == full_map.camera.name
        assert hdus[0].header["EXPMAX"] == 2.0 and hdus[0].header["DATE"] == full_map.created
        assert hdus[0].header["INSTRUME"] == "MT9V022"


def test_map_info_has_the_agreed_names(map_path):
    info = map_info(map_path)
    assert {"camera", "layers", "intrinsics", "conditions", "verdicts", "created", "schema"} <= info.keys()
    assert info["layers"]["offset_dn"]["measured"] is True and info["layers"]["gain_dn_per_e"]["value"] == 0.103
    assert info["intrinsics"]["distortion"]["k3"] == 0.013 and info["intrinsics"]["uncertainty"]["fx_px"] > 0
    assert info["verdicts"][0]["status"] == "pass" and info["schema"] == 1
    json.dumps(info, allow_nan=False)


def test_verify_lists_every_check_of_a_good_file(map_path):
    checks = verify_map(map_path)
    assert all(check.ok for check in checks)
    assert [check.name for check in checks] == ["readable", "a calibench map", "schema", "length", "SHA-256",
                                                "FITS checksums", "extensions", "content"]


def test_a_map_of_nothing_measured_reads_back(tmp_path):
    path = tmp_path / "empty.fits"
    write_map(path, CalibrationMap(image_size_px=(4, 3)))
    assert read_map(path).measured == frozenset()


def test_evidence_that_fits_cannot_hold_is_refused(tmp_path):
    bad = CalibrationMap(image_size_px=(4, 3), evidence={"dark/z": np.array([1j])})
    with pytest.raises(BadInput, match="complex128"):
        write_map(tmp_path / "z.fits", bad)
    assert list(tmp_path.iterdir()) == []
