"""The report of a small made-up session: complete, self-contained, honest about what is missing, safe against hostile text."""

from __future__ import annotations

import dataclasses
import re
from html.parser import HTMLParser

import numpy as np
import pytest

from calibench import registry
from calibench.calmap.assemble import assemble
from calibench.geometry import projection
from calibench.records import (
    DEFECT_FLAGS,
    Attitude,
    Camera,
    Identification,
    Intrinsics,
    Limit,
    Measurement,
    Observer,
    Provenance,
    PsfMap,
    Quantity,
    Spots,
    StarTable,
    Verdict,
)
from calibench.report.build import SECTIONS, build_report
from calibench.report.numbers import ARCSEC, sigma
from calibench.report.story import ShotStory, SkyStory, Story
from calibench.stars.sky_catalogue import SkyCatalogue
from calibench.stars.solve import Solution
from calibench.validate.case import SkyTruth, Trial

SIZE = W, H = 96, 64
PNG_START = "data:image/png;base64,iVBORw0KGgo"
ALL = ("overview", "intrinsics", "dark", "flat", "psf", "sky", "ablation", "provenance")


def lens() -> Intrinsics:
    return Intrinsics(model="brown5", fx_px=180.0, fy_px=180.0, cx_px=48.0, cy_px=31.0, image_size_px=SIZE,
                      distortion=np.array([-0.3, 0.1, 1e-3, -5e-4, 0.0]),
                      covariance=np.diag([0.2, 0.2, 0.4, 0.4, 1e-3, 1e-2, 1e-4, 1e-4, 1e-2]) ** 2)


def lens_measurement(rng: np.random.Generator) -> Measurement:
    corners = rng.uniform([5, 5], [90, 60], (120, 2))
    inlier = np.arange(120) > 2
    residual = rng.normal(0, 0.05, (120, 2))
    residual[119] = 0.6, -0.8  # of the last view
    board_mm = np.column_stack([a.ravel() for a in np.meshgrid(np.arange(6) * 10.0, np.arange(5) * 10.0)] + [np.zeros(30)])
    poses = np.array([[0, 0, 0, -25, -20, 300], [0.5, 0, 0, 0, 0, 400], [0, -0.3, 0, 0, 0, 500], [0, 0.2, 0, 0, 0, 600]])
    return Measurement(
        name="intrinsics", image_size_px=SIZE, intrinsics=lens(), frames_used=4,
        quantities=(Quantity(name="rms_px", value=0.05, unit="px", source="over inliers"),
                    Quantity(name="held_out_rms_px", value=0.06, unit="px", source="over inliers")),
        evidence={"corners_xy_px": corners, "residual_px": residual, "inlier": inlier, "poses": poses,
                  "corners_view": np.repeat(np.arange(4), 30), "corners_board_mm": np.tile(board_mm, (4, 1)),
                  "held_out_rms_by_model_px": np.array([0.09, 0.06, np.inf]),
                  "uncertainty_classical": np.full(11, 0.1), "view_rms_px": np.array([0.04, 0.05, 0.06, 0.31]),
                  "view_left_out_rms_px": np.array([0.05, 0.06, 0.07, 0.33]), "view_effect_sd": np.array([0.1, 0.2, 0.3, 1.5]),
                  "worst_views": np.array([3, 2]), "worst_views_picture": np.zeros((2, 32, 48), np.uint8),
                  "training_rms_by_model_px": np.array([0.08, 0.05, np.nan]),
                  "coverage_count": np.histogram2d(*corners.T[::-1], bins=(6, 8), range=((0, H), (0, W)))[0].astype(int)},
        provenance=Provenance(inputs={"boards/a.png": "ab" * 32},
                              settings={"board": (9, 6), "views": ("b/v1.png", "b/v2.png", "b/v3.png", "b/blurred.png")}))


def dark_measurement(rng: np.random.Generator) -> Measurement:
    rate = rng.normal(1.2, 0.1, (H, W))
    rate[10, 20] = 77.0
    defects = np.zeros((H, W), np.uint16)
    defects[10, 20] = DEFECT_FLAGS["hot"] | DEFECT_FLAGS["hot_thesis"]
    return Measurement(
        name="dark", image_size_px=SIZE, frames_used=6, warnings=("temperature drifted",),
        frames_rejected=(("d/x.png", "twin"),),
        maps={"offset_dn": rng.normal(64, 0.5, (H, W)), "dark_rate_dn_per_s": rate, "defects": defects},
        quantities=(Quantity(name="offset_dn", value=64.0, uncertainty=0.01, unit="DN"),
                    Quantity(name="dark_rate_dn_per_s", value=1.2, uncertainty=0.02, unit="DN/s"),
                    Quantity(name="read_noise_e", value=None, unit="e-", reason="gain unknown")),
        evidence={"exposure_s": np.array([0.1, 0.5, 1.0]), "mean_level_dn": np.array([64.12, 64.61, 65.2]),
                  "frame_count": np.array([2, 2, 2]), "temporal_variance_dn2": np.array([1.0, 1.1, 1.2]),
                  "hot_thesis_count": np.array([0, 1, 1])})


def flat_measurement(rng: np.random.Generator) -> Measurement:
    y, x = np.mgrid[:H, :W]
    return Measurement(name="flat", image_size_px=SIZE, frames_used=6, layers={"gain_dn_per_e": 0.1},
                       maps={"response": rng.normal(1, 0.01, (H, W)),
                             "illumination": 1 - 0.3 * ((x - W / 2) ** 2 + (y - H / 2) ** 2) / W**2},
                       quantities=(Quantity(name="gain_dn_per_e", value=0.1, uncertainty=0.001, unit="DN/e-"),),
                       evidence={"transfer_signal_dn": np.array([100.0, 400.0]),
                                 "transfer_variance_dn2": np.array([10.0, 40.0]),
                                 "transfer_variance_uncertainty_dn2": np.array([0.1, 0.4])})


def psf_measurement(rng: np.random.Generator) -> Measurement:
    psf = PsfMap(model="gaussian", degree=2, image_size_px=SIZE, centre="fitted centre", residual_rms_px2=0.01,
                 coefficients=np.array([[0.5, 0, 0, 0.4, 0, 0.1], [0.5, 0, 0, 0.1, 0, 0.4], [0, 0, 0, 0, 0.3, 0]]),
                 measured_xy_px=rng.uniform(0, 60, (30, 2)))
    return Measurement(name="psf", image_size_px=SIZE, psf=psf, frames_used=2,
                       quantities=(Quantity(name="fwhm_px", value=1.7, uncertainty=0.02, unit="px"),),
                       evidence={"encircled_radius_px": np.linspace(0, 4, 9), "encircled_fraction": np.linspace(0, 1, 9)})


def stars(hip: np.ndarray) -> StarTable:
    n = len(hip)
    zero = np.zeros(n)
    return StarTable(epoch_jyear=2000.0, hip=hip, hr=np.zeros(n, int), ra_rad=np.linspace(-0.1, 0.1, n),
                     dec_rad=np.linspace(-0.05, 0.08, n), pm_ra_mas_yr=zero, pm_dec_mas_yr=zero, parallax_mas=zero,
                     hp_mag=np.linspace(1, 4.9, n), v_mag=np.linspace(1, 4.9, n), b_v=zero, spectral_type=np.array(["A0"] * n))


def solution(rng: np.random.Generator, status: str = "solved") -> Solution:
    n = 6
    xy = rng.uniform([5, 5], [90, 60], (n + 2, 2))
    spots = Spots(xy_px=xy, covariance_px2=np.tile(np.eye(2) * 0.01, (n + 2, 1, 1)), flux_e=np.full(n + 2, 900.0),
                  background_dn=np.zeros(n + 2), peak_dn=np.full(n + 2, 50.0), pixels=np.full(n + 2, 9), flags=np.zeros(n + 2))
    identity = np.array([0, 0, 0, 1.0])
    if status != "solved":
        return Solution(file="s.png", spots=spots, identification=Identification(status=status, method="pattern", reason="dew"),
                        attitude=Attitude(status=status, method="quest", q_cam_icrs=identity, reason="dew on the lens",
                                          covariance_rad2=np.full((3, 3), np.inf)))
    found = Identification(status="solved", method="pattern", spot_rows=np.arange(n), star_rows=np.arange(n), xy_px=xy[:n],
                           covariance_px2=np.tile(np.eye(2) * 0.01, (n, 1, 1)), false_match_probability=3e-12,
                           direction_icrs=projection.unproject(lens(), xy[:n]), intrinsics=lens())
    attitude = Attitude(status="solved", method="quest", q_cam_icrs=identity, covariance_rad2=np.diag([1, 1, 25]) * 1e-10,
                        residual_px=np.tile([0.3, -0.4], (n, 1)))
    return Solution(file="s.png", spots=spots, identification=found, attitude=attitude, ra_rad=1.0, dec_rad=-0.2, roll_rad=0.3,
                    fov_rad=0.5, calibrated=True, timings_s={"detect": 0.1, "identify": 0.2})


@pytest.fixture(scope="module")
def story() -> Story:
    rng = np.random.default_rng(5)
    measurements = [make(rng) for make in (lens_measurement, dark_measurement, flat_measurement, psf_measurement)]
    calmap = assemble(measurements, camera=Camera(name="test camera"), software="calibench 0", created="2025-01-01")
    limit = Limit(measurement="dark", quantity="dark_rate_dn_per_s", maximum=1.0, unit="DN/s", why="hot pixels look like stars")
    catalogue = SkyCatalogue.seen_by(stars(np.arange(11, 20)), Observer())
    truth = SkyTruth(centre_icrs=np.array([np.cos(1.0) * np.cos(0.2), np.sin(1.0) * np.cos(0.2), -np.sin(0.2)]), roll_rad=0.3)
    trial = Trial(name="ablation", reading="rms error of the image's centre", columns=("map", "error_arcsec", "earned_arcsec"),
                  rows=(("no map", 90.0, 60.0), ("whole map", 30.0, None), ("without dark", 42.5, 12.5),
                        ("without psf", 29.0, -1.0)))
    return Story(title="Camera seven", why="before delivery", created="2025-01-02", software="calibench 0", calmap=calmap,
                 shots=(ShotStory(name="flats", folder="flats", what="lit field", why="response", wanted=30, found=6,
                                  status="fail", remarks=("six only",)),),
                 measurements={m.name: m for m in measurements}, trials={"ablation": trial}, star_names={11: "Firststar"},
                 verdicts=(Verdict(limit=limit, status="fail", value=1.2, uncertainty=0.02, reason="1.2 DN/s is above 1"),),
                 sky=(SkyStory(name="sky_a", signal_dn=rng.normal(0, 1, (H, W)), raw=solution(rng, "no_match"),
                               calibrated=solution(rng), truth=truth, catalogue=catalogue),
                      SkyStory(name="sky_b", signal_dn=rng.normal(0, 1, (H, W)), raw=solution(rng),
                               calibrated=solution(rng, "no_match"))),
                 seconds={"measure": 3.0, "solve": 1.0})


class Page(HTMLParser):
    """Tags with their attributes, and the text of a page."""

    def __init__(self, html: str):
        super().__init__()
        self.tags: list[tuple[str, dict]] = []
        self.words: list[str] = []
        self.feed(html)

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data):
        self.words.append(data)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())

    def all(self, tag: str) -> list[dict]:
        return [attributes for name, attributes in self.tags if name == tag]


@pytest.fixture(scope="module")
def html(story) -> str:
    return build_report(story)


@pytest.fixture(scope="module")
def page(html) -> Page:
    return Page(html)


def test_every_section_is_there_in_its_order_and_in_the_contents(page):
    shown = [a["id"] for a in page.all("section")]
    assert set(ALL) <= set(shown)
    assert shown == sorted(shown, key=lambda name: registry.load(SECTIONS, name).ORDER)
    assert [a["href"] for a in page.all("a")] == [f"#{name}" for name in shown]
    assert all(registry.load(SECTIONS, name).TITLE in page.text for name in shown)


def test_nothing_is_fetched_and_nothing_runs(html, page):
    links = [v for _, attributes in page.tags for k, v in attributes.items() if k in ("src", "href", "srcset", "action")]
    assert links and all(link.startswith(("#", PNG_START)) for link in links)
    assert not {"script", "link", "iframe", "object"} & {tag for tag, _ in page.tags}
    assert "url(" not in html and "@import" not in html
    assert len(html) < 6e6


def test_every_figure_has_a_reading_with_figures_in_it_and_an_alternative_text(page, html):
    images = page.all("img")
    assert len(images) >= 22
    captions = re.findall(r"<figcaption>(.+?)</figcaption>", html)
    assert len(captions) == len(images) and all(re.search(r"\d", caption) for caption in captions)
    assert all(caption.endswith(".") and caption[0] == caption[0].upper() for caption in captions)
    assert all(len(a["alt"]) > 30 and a["src"].startswith(PNG_START) for a in images)


def test_the_same_story_gives_the_same_bytes(story, html):
    assert build_report(story) == html


@pytest.mark.parametrize("said", [
    "dark.dark_rate_dn_per_s: 1.2 DN/s is above 1", "dark: temperature drifted", "dark: d/x.png was not used: twin",  # warnings
    "1 outside limits", "1 of 2 sky frames solved", "six only", "hot pixels look like stars",
    "The worst view, blurred, has 0.310 px", "crossed out: 3 outliers among 120 corners",
    "the hottest pixel, (20, 10), collects 770 e-/s", "1 hot, 1 hot_thesis", "gain unknown", "10 e-/DN",
    "Half of the light lies within 2 px", "sky_b: no match: dew on the lens", "3.0 × 10⁻¹²",
    "The brightest matched is Firststar", "with the map 0.500 px rms", "ab" * 32,
    "The whole map earns 60 arcsec over no map; of its layers dark earns most, 12.5 arcsec", "falls without psf (−1 arcsec)",
])
def test_what_the_story_holds_is_said_in_words_and_figures(page, said):
    assert said.lower() in page.text.lower()


def test_the_systematic_error_of_a_solution_is_given(page, story):
    centre = story.sky[0].calibrated.systematic_centre_rad * ARCSEC
    assert np.isfinite(centre) and f"{sigma(centre)}, {sigma(centre, 3)}" in page.text


def test_readings_follow_the_data(story):
    dark = story.measurements["dark"]
    rate = dark.maps["dark_rate_dn_per_s"].copy()
    rate[10, 20], rate[33, 44] = 1.0, 99.0
    other = dataclasses.replace(dark, maps={**dark.maps, "dark_rate_dn_per_s": rate})
    section = registry.load(SECTIONS, "dark").render(dataclasses.replace(story, measurements={"dark": other}))
    assert any("(44, 33), collects 990 e-/s" in figure.reading for figure in section.figures)


@pytest.mark.parametrize("name", ["intrinsics", "dark", "flat", "psf"])
def test_a_section_without_its_measurement_is_left_out(story, name):
    left = {k: v for k, v in story.measurements.items() if k != name}
    assert registry.load(SECTIONS, name).render(dataclasses.replace(story, measurements=left)) is None


def test_views_are_listed_from_the_worst_with_where_the_board_stood(story):
    section = registry.load(SECTIONS, "intrinsics").render(story)
    (views,) = (t for t in section.tables if t.title.startswith("Views"))
    assert [row[0] for row in views.rows] == ["blurred", "v3", "v2", "v1"]
    assert views.rows[0][6:8] == ("1.5", "11.5")
    assert views.rows[0][1:6] == ("30", "0", "0.310", "1", "0.330")  # 0.2 rad
    assert views.rows[3][1:3] == ("27", "3") and views.rows[3][7:] == ("0.0", "300")
    (stood,) = (f for f in section.figures if f.title.startswith("Where the board stood"))
    assert "worst view, blurred" in stood.reading and "0.0 to 28.6 degrees" in stood.reading


def test_held_out_rms_stands_beside_the_training_rms(story):
    section = registry.load(SECTIONS, "intrinsics").render(story)
    (held_out,) = (t for t in section.tables if t.title.startswith("Training"))
    assert held_out.rows == (("brown4", "0.08000", "0.09000", "1.125", "1.500"),
                             ("brown5 (used)", "0.05000", "0.06000", "1.200", "1"), ("rational8", *4 * ("–",)))
    assert "1.20 times the training rms" in held_out.note


def test_an_empty_story_is_a_short_report(story):
    bare = Story(title="Nothing yet", why="", created="", software="", calmap=dataclasses.replace(
        story.calmap, quantities={}, inputs={}, settings={}, warnings=()))
    assert tuple(a["id"] for a in Page(build_report(bare)).all("section")) == ("overview", "provenance")


@pytest.mark.parametrize("name", ["intrinsics", "dark", "flat", "psf"])
def test_missing_evidence_leaves_out_its_figure_and_nothing_else(story, name):
    whole = story.measurements[name]
    render = registry.load(SECTIONS, name).render
    poor = render(dataclasses.replace(story, measurements={name: dataclasses.replace(whole, evidence={})}))
    rich = render(dataclasses.replace(story, measurements={name: whole}))
    assert {f.title for f in poor.figures} < {f.title for f in rich.figures}


def test_pixels_without_a_value_do_not_spoil_the_figures(story):
    for name in ("dark", "flat"):
        whole = story.measurements[name]
        maps = {key: np.array(value) for key, value in whole.maps.items()}
        for values in maps.values():
            if values.dtype.kind == "f":
                values[0, 0], values[5, 7] = np.nan, np.inf
        section = registry.load(SECTIONS, name).render(
            dataclasses.replace(story, measurements={name: dataclasses.replace(whole, maps=maps)}))
        readings = " ".join(figure.reading for figure in section.figures)
        assert "–" not in readings and "nan" not in readings and "inf " not in readings


def test_a_lens_of_unknown_errors_and_no_distortion_still_has_its_table(story):
    ideal = Intrinsics.pinhole(focal_px=180.0, image_size_px=SIZE)
    measurement = Measurement(name="intrinsics", image_size_px=SIZE, intrinsics=ideal)
    section = registry.load(SECTIONS, "intrinsics").render(dataclasses.replace(story, measurements={"intrinsics": measurement}))
    assert section.tables[0].rows[0][:3] == ("fx", "180", "–") and section.figures == ()


HOSTILE = "<script>alert(1)</script><img src=x onerror=y> {{ 7*7 }} \" ' &"


def test_hostile_text_stays_text(story):
    shot = dataclasses.replace(story.shots[0], name=HOSTILE, remarks=(HOSTILE,))
    hostile = dataclasses.replace(
        story, title=HOSTILE, why=HOSTILE, software=HOSTILE, shots=(shot,), star_names={11: HOSTILE}, seconds={HOSTILE: 1.0},
        sky=(dataclasses.replace(story.sky[0], name=HOSTILE),),
        calmap=dataclasses.replace(story.calmap, warnings=(HOSTILE,), camera=Camera(name=HOSTILE),
                                   inputs={f"dark/{HOSTILE}": HOSTILE}, settings={HOSTILE: {HOSTILE: HOSTILE}}))
    page = Page(build_report(hostile))
    assert not page.all("script") and not any("onerror" in attributes for _, attributes in page.tags)
    assert page.text.count("<script>alert(1)</script>") >= 10 and "{{ 7*7 }}" in page.text


def test_badges_differ_in_sign_and_word_not_in_colour_only(html):
    badges = set(re.findall(r'<span class="badge (\w+)"><span[^>]*>(.)</span>([^<]+)</span>', html))
    signs = {tone: sign for tone, sign, _ in badges}
    assert {"good", "bad"} <= signs.keys() and len(set(signs.values())) == len(signs)
    assert ("bad", "✗", "no match") in badges and ("good", "✓", "solved") in badges
