"""Constants of the estimator, by module; those of the filter itself are in :mod:`.tuning`."""

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class CameraMonitorTuning:
    late_s: float = 0.005
    late_fraction: float = 0.1
    """Stamps are called late from here on, when it is known to this fraction of it,"""
    jump_sigmas: float = 3.0
    """A jump of stamps is reported from 5 ms and so many standard deviations on."""
    late_still_s: float = 0.0025
    """and until what is known of them comes down to this."""
    focal_threshold: float = 0.003
    focal_named: float = 0.01
    focal_sigmas: float = 6.0
    focal_estimates: int = 10
    """A focal length is corrected from the first share on, when it is so sure, after so many estimates, and named from
    the second one on."""
    focal_seems: float = 3.0
    """What is known less surely than that does not even count as error."""
    focal_step: float = 0.001
    """Smaller changes of the estimate are not applied."""
    bend: float = 0.5
    """A distortion that is off by a share bends a picture as a focal length does that is off by this times it. What is
    seen is divided between them by how far either may be off; the height hangs on the focal length only."""
    bent_share: float = 0.2
    """A picture with another distortion puts the vehicle elsewhere by up to this share of it times the height: it shows
    another tilt. Found with distortions of +-20 % over a floor of markers."""
    doubted: float = 3.0
    """Times what both may be off by together, from where on the calibration is in doubt."""
    ahrs_tilt_rad: float = 0.0145
    """Standard deviation of the tilt of an AHRS that is to be heard of: 0.83 degrees, of which three are five of the
    usual 0.5, so that hours pass without."""
    tilted_us: int = 3_000_000
    """Tilt of the camera against the AHRS is reported after it has lasted so long."""
    aside_m: float = 0.1
    """A picture whose scale is wrong is off sideways by that share of this: its middle is not below the vehicle."""
    focal_every_us: int = 200_000
    focal_soon: int = 15
    """So many of the first pictures are all asked: a wrong lens is found before the vehicle moves."""
    pattern_noise: float = 3.0
    """Corner errors of one place and of one lens are alike: a picture's own standard deviation counts so many times."""
    forget_estimates: int = 600
    lately_estimates: int = 10
    """Looks (two minutes, two seconds) after which older ones count for less."""
    changed_share: float = 0.25
    """A change of what the looks say counts from 1 % of the focal length and this share of what they said on."""
    least_markers: int = 6
    """Fewer show no pattern,"""
    least_power_px: float = 1.0
    """nor does a lens that bends all corners of a picture by less than this together."""


CAMERA_MONITOR = CameraMonitorTuning()


@dataclass(frozen=True, slots=True)
class ComplementaryTuning:
    fix_period_s: float = 1.0 / 30.0
    """The gains per fix below are the continuous ones times this."""
    k_current_s: float = 0.024
    """m/s per m/s^2 of every update by the model (50 Hz): time constant 0.4 s at cruise speed, 3 s at rest."""
    fix_floor: tuple[float, float] = (0.008, 0.004)
    """m, rad: fixes are never taken as better than this, which sets k1 to about 8 /s in steady state."""
    gate_floor: tuple[float, float] = (0.03, 0.02)
    """m, rad: standard deviation of the residual that the gate allows at least; the variances here know no
    correlations."""
    model_gate_sigma_m_s2: float = 0.4
    pos_noise: float = 0.012
    yaw_noise: float = 0.008
    vel_noise: float = 0.06
    """Per sqrt(s): what k1 and the growth of the variances in a gap follow from."""
    vel_shrink: float = 0.85
    """Share of the velocity's variance that a fix leaves."""
    current_variance: float = 0.06**2
    offset_noise: float = 0.0087
    laser_bias_noise: float = 1e-3
    depth_offset_noise: float = 3e-4


COMPLEMENTARY = ComplementaryTuning()


@dataclass(frozen=True, slots=True)
class SwellTuning:
    """Constants of :class:`autopilot.estimator.measure_model.Swell`."""

    follow_s: float = 5.0
    """Longer than half a wave, shorter than a leg."""
    mean_s: float = 3.0
    """Mean of the states against which waves are seen."""
    longest_s: float = 0.1
    """Of the time between two looks that counts."""
    usual_m_s2: float = 0.1
    """Rms of what goes to and fro in flat water is 0.03 to 0.07, by currents, drag and thrust that the file has not;
    up to 0.1 with half a thruster."""
    shared_looks: float = 25.0
    """Looks of half a second, in which a wave pushes the same way: they count as one."""


SWELL = SwellTuning()


@dataclass(frozen=True, slots=True)
class MeanFlowTuning:
    """Constants of :class:`autopilot.estimator.measure_model.MeanFlow`."""

    mean_s: float = 5.0
    """Longer than what the estimate of a current errs for. For so long at first there is no mean."""
    noise_m_s: float = 0.1
    """Three standard deviations of a current that is known. In still water, 330 s straight on, drag is off by 0.1 in
    the end (by 0.27 without a mean), and in the paper's tank the current as well known as without."""
    longest_s: float = 0.1
    """Of the time between two looks that counts."""


MEAN_FLOW = MeanFlowTuning()


@dataclass(frozen=True, slots=True)
class InertialMonitorTuning:
    residual_time_s: float = 0.2
    """The accelerometer's residual is smoothed over this: longer than its noise, shorter than it takes to drift
    away."""
    residual_limit_m_s2: tuple[float, float, float] = (0.15, 0.15, 0.12)
    """Forward, right, down: twice what models were wrong by in healthy flights, thruster losses among them. Six degrees
    of tilt let in 1."""
    explained_sigmas: float = 3.0
    """The water and a velocity that has drifted explain so many standard deviations of the model more."""
    absurd_m_s2: float = 2.0
    """Beyond what thrusters and a bump at cruise speed make of a hull, smoothed: whatever the fixes say so far."""
    usual_time_s: float = 3.0
    """What the residual is while fixes agree with the accelerometer is the model's own error, learned this slowly."""
    rejections: int = 12
    """Looks at the model rejected in a row (0.24 s) that count like a residual beyond its limit."""
    turn_time_s: float = 1.0
    slow_turn_time_s: float = 3.0
    quick_turn_time_s: float = 0.3
    """The same over a shorter time, when fixes deny the heading as well."""
    coast_share: float = 0.5
    """In a gap this share of what gyro and compass have come apart counts as error of the heading: 3 sigma are half
    more than a gyro that is wrong turns it by, since the compass errs as well."""
    coast_free_rad: float = math.radians(3.0)
    """What is beyond that, twice what the steel of a tank does, lets the compass turn the estimate."""
    coast_denied_rad: float = math.radians(3.0)
    coast_denied_rad_s: float = math.radians(0.3)
    """The first fixes after a gap deny a gyro whose turning in it they miss by more than this, and a bias of so much
    more, if the compass misses it likewise."""
    jump_rad: float = 0.1
    """From one sample to the next a compass that turns by so much more than the gyro has jumped."""
    contradictions: int = 3
    """Fixes rejected in a row, and agreeing among themselves, that deny the estimate: 1 in 10^9 by chance."""
    steady_time_s: float = 1.0
    steady_s: float = 3.0
    """A sensor is trusted again after so long of steadiness with fixes ..."""
    steady_m_s2: float = 0.12
    steady_rad_s: float = 0.06
    """... within these, smoothed absolute deviations from its mean."""


INERTIAL_MONITOR = InertialMonitorTuning()


@dataclass(frozen=True, slots=True)
class EngineTuning:
    ahrs_wait_us: int = 60_000
    """Timeout of AHRS data, after which the filter continues without."""
    ahrs_gap_us: int = 45_000
    """The same beyond their usual age on arrival,"""
    ahrs_age_max_us: int = 400_000
    """which is taken for no more than this."""
    blind_after_us: int = 200_000
    """Time without AHRS samples after which the estimate is dead reckoning: a few lost ones change nothing."""
    restarted_us: int = 1_500_000
    """After so long a silence the AHRS may have been restarted, which is the remedy for wrong readings: they count
    anew. A flight controller's reboot takes two seconds."""
    blind_step_us: int = 20_000
    blind_steps_max: int = 500
    """At most so many steps without AHRS data per tick; they get longer when the gap is longer."""
    blind_tilt_decay: float = 0.99
    """Per blind step: roll and pitch fade to level within 2 s."""
    alone_after_us: int = 150_000
    """Time without either after which gyro and compass are held against each other: a gyro that begins to be wrong
    soon turns the heading beyond its sigma. Fixes come twice as often, latency included."""
    coast_after_us: int = 300_000
    """Time without a fix or a velocity over ground after which the current is held."""
    alone_rhythms: float = 1.1
    coast_rhythms: float = 1.5
    """The same for slow sources, in times that the newest fix usually reaches before the next;"""
    longest_rhythm_us: int = 800_000
    """of which no more is believed: two fixes a second, with 0.3 s of latency."""
    rhythms_kept: int = 5
    """Their median is the usual one: a gap or two change nothing."""
    frozen_readings: int = 5
    """Equal readings of a pressure sensor or velocity log after the first one: the next are of no use, at rest too."""
    tracked_us: int = 1_000_000
    """Largest age of a velocity over ground for dead reckoning."""
    redriven_us: int = 800_000
    """A sensor that becomes suspect has been wrong for up to so long."""
    suspect_us: int = 1_000_000
    """At least so long an estimate is not called good after a sensor has become suspect."""
    anchored_us: int = 500_000
    """With a suspect sensor the estimate is good only when fixes have been used for so long."""


ENGINE = EngineTuning()


@dataclass(frozen=True, slots=True)
class WaterTuning:
    """Chosen with ``python -m tests.bench.gaps --seed 92001 --gaps 8``."""

    span_us: int = 2_000_000
    """The current is compared with itself over this: what the vehicle crosses changes within a second or two."""
    least_m_s: float = 0.1
    """Added to the speed: water changes at a vehicle that stands still."""
    first_per_m: float = 0.01
    first_spans: float = 2.0
    """Expected before anything was met [m^2/s^2 / m], and worth so many spans."""
    most_spans: float = 15.0
    """Older ones are forgotten."""


WATER = WaterTuning()


@dataclass(frozen=True, slots=True)
class EvidenceTuning:
    ratio_gain: float = 0.2
    ratio_most: float = 2.0
    ratio_shows: float = 0.35
    ratio_denies: float = 0.6
    """Squared distance of the fixes over its gate, smoothed over five of them: 0.2 with a filter that is right. From
    the first limit on their mean miss counts as error of the estimate, from the second on they deny it."""
    explained: float = 1.6
    """Times gyro and compass are apart that fixes may miss the heading by: a gyro that is wrong makes both grow alike,
    but for what is forgotten of the first (1.58 after 0.3 s)."""
    denied_after: int = 6
    """Fixes rejected in a row (0.2 s) after which the estimate is not called good."""
    jump_m: float = 0.05
    jump_rad: float = 0.05
    """Smaller steps are normal corrections of the filter."""
    jump_us: int = 5_000_000
    """Time for which the estimate is not GOOD after a jump of fixes."""
    jump_fade_s: float = 10.0
    """A jump that nothing on board felt fades from the variance with this: what the fixes say now may be as wrong."""
    jump_path_m: float = 0.5
    """The position is off by the jump of the heading times this: the path within the seconds after it."""
    range_miss_m: float = 0.04
    range_sigmas: float = 3.0
    """A laser that needs a larger offset denies the height: twice what a mounted laser is off by, and so many of the
    standard deviations that it states."""
    resets: int = 3
    resets_us: int = 30_000_000
    """Number of resets within a time that is a finding: map, camera or stamps are wrong."""


EVIDENCE = EvidenceTuning()


@dataclass(frozen=True, slots=True)
class DepthTuning:
    offset_m: float = 0.2
    """A zero that is farther from the surface than weather (10 hPa are 0.1 m) and mounting explain."""
    ratio_gain: float = 0.05
    """Smooths the squared residuals over two seconds of samples; two outliers in a row are not enough."""


DEPTH = DepthTuning()


@dataclass(frozen=True, slots=True)
class FixMotionTuning:
    span_us: int = 4_000_000
    """At most so long a run of fixes is held against dead reckoning."""
    most: int = 128
    alike: float = 4.0
    """Errors of fixes are alike over some pictures: so many count as one."""
    systematic_per_s: float = 0.02
    """and more for each second without a fix [m/s per s]: jets change the velocity by 0.1 m/s within 5 s."""
    unaided: float = 0.2
    """[m/s, rad/s] more while the accelerometer (the gyro) is suspect."""
    unknown_m_s: float = 0.5
    """A vertical speed that dead reckoning knows no better does not count: it is corrected at random by what the
    horizontal accelerations say of it, and without a depth sensor it is soon that uncertain."""
    sure: float = 12.0
    """Difference of the logarithms of two likelihoods that is acted on: 4.9 sigma."""
    least: int = 3
    """Fixes that make a motion."""
    good_fit: float = 3.0
    """Squared misses of a run that fits may be so many times what noise makes of it."""


FIX_MOTION = FixMotionTuning()


@dataclass(frozen=True, slots=True)
class FrameFilterTuning:
    step_px: int = 8
    """Sampling step: every eighth pixel of every eighth row, 4800 of an image of 640 x 480."""
    dark_level: float = 6.0
    bright_level: float = 249.0
    """Grey levels: if nine tenths of the pixels lie below (above), the lens is covered or the exposure is lost."""
    white_level: int = 250
    black_level: int = 8
    """Grey levels from which on (up to which) a pixel says nothing."""
    most: float = 0.9
    flat_levels: int = 3
    """An image whose levels all lie within so many shows nothing, not even noise."""
    torn_fraction: float = 0.05
    """An image of which this fraction of rows, up from the bottom, is one single colour has not arrived whole."""


FRAME_FILTER = FrameFilterTuning()


@dataclass(frozen=True, slots=True)
class LaserDotTuning:
    range_band: tuple[float, float] = (0.75, 1.35)
    """Search range of the dot, as factors of the predicted range."""
    range_slack_m: float = 0.03
    any_range_m: tuple[float, float] = (0.2, 3.0)
    """Search range without a prediction."""
    pad_px: int = 10
    """Half height of the search strip."""
    off_line_px: int = 5
    """Half height of the part of it where the dot may be: distortion, calibration."""
    smooth_sigma_px: float = 1.5
    """Of the dot's image."""
    min_excess: float = 6.0
    """Grey levels by which the smoothed dot must be greener than its brightness explains: six times the noise."""
    min_contrast: float = 6.0
    """The same in robust standard deviations of the strip."""
    centroid_px: int = 3
    """Half width of the window whose centre of mass is the dot."""


LASER_DOT = LaserDotTuning()


@dataclass(frozen=True, slots=True)
class MagneticTuning:
    size_fraction: float = 0.1
    smooth_s: float = 0.05
    most_ratio: float = 3.0
    """More than so many times the known size counts as so many, so that one wild reading is soon forgotten."""
    known_s: float = 20.0
    """The known field follows slowly: that of another place in the same water."""
    same_after_s: float = 0.5
    """A field that was another one has to be right for so long."""
    new_after_s: float = 20.0
    patience_s: float = 60.0
    """After so long without the known field any is better than gyros alone."""
    impatient_trust: float = 0.5


MAGNETIC = MagneticTuning()


@dataclass(frozen=True, slots=True)
class MapMonitorTuning:
    sightings: int = 8
    """Pictures that must show a marker at the same wrong place."""
    alone: int = 30
    """Pictures until an id at another marker's place is reported although that one has not been seen at its own."""
    same_m: float = 0.006
    """A marker that does not move is seen within this, standard deviation."""
    taken_m: float = 0.015
    """So close to where the map has another marker an outlier lies in that one's place."""
    strains: int = 5
    strains_us: int = 1_000_000
    """Pictures within a time in which a sheet does not fit to its neighbours: it may lie anywhere then."""
    loose_variance: tuple[float, float, float, float] = (0.03**2, 0.03**2, 0.003**2, 0.1**2)
    """m^2, rad^2: how far off a sheet may be that does not fit."""
    off_distance2: float = 40.0
    """Squared distance of a sheet's offset from what it was said to be, of 4, from which on it is named."""
    held_us: int = 10_000_000
    """Time after the last finding for which the map counts as suspect."""


MAP_MONITOR = MapMonitorTuning()


@dataclass(frozen=True, slots=True)
class MarkerImageTuning:
    off_center: float = 0.22
    off_center_px: float = 2.0
    """Each cell is sampled at four points this far from its centre [cells], at most so many pixels: light that changes
    over a large cell is no noise."""
    misread_center: float = 0.1
    """The same where the question is only whether a cell is black or white."""
    edge_cells: float = 0.6
    """Profiles across the outline reach this far to both sides [cells]: into the black border and the white around
    it."""
    edge_steps: int = 13
    edge_places: int = 6
    """Profiles along each side."""
    min_width_px: float = 0.5
    sigma_factor: float = 1.45
    window_px: float = 5.0
    """Of :func:`corner_sigma_px`, for a window of that half width: found on rendered floors from clear water to 3 1/m,
    where corners are 0.1 to 1.3 px off. On four photographs of a board, which had no part in it, it gives 0.34 to 0.45
    px where corners lie 0.32 to 0.42 px from where board and camera model put them."""
    widest_px: float = 3.6
    """Wider edges make corners no worse: they are those of large markers, whose window holds more of them."""
    min_sigma_px: float = 0.06


MARKER_IMAGE = MarkerImageTuning()


@dataclass(frozen=True, slots=True)
class MarkersPoseTuning:
    nearest_m: float = 0.45
    """A marker is not looked for further from where it seems to lie: markers of one id are a metre and more apart."""
    common_shift_m: float = 0.06
    """All markers of one image must be displaced alike, within this, or are wrong."""
    vote_m: float = 0.08
    vote_rad: float = 0.15
    vote_scale: float = 0.1
    """Votes for the camera's place agree within these (position, heading, share of the height)."""
    similar: float = 0.15
    """A quadrilateral may differ from the marker's square by this share of its side, else it is not a marker."""
    nowhere_markers: int = 3
    nowhere_pictures: int = 90
    """So many markers of the map in each of so many pictures in a row, which are nowhere on it, are no accident."""
    reject_sigmas: float = 3.0
    reject_floor_px: float = 1.0
    """A marker with a corner further than this from its projection is left out."""
    reject_rounds: int = 4
    first_rms_px: float = 40.0
    final_rms_px: float = 3.0
    """A fit may be this bad before and after markers have been left out."""
    few: int = 8
    """Among so few, one that is off gives the others residuals that hide its own (of four, 1 part against 3): each is
    left out in turn."""
    outliers_from: int = 3
    """Markers of the map in a picture in which one may be called an outlier: two against one,"""
    outlier_m: float = 0.012
    """and how far off those are."""
    steep: float = 0.3
    """A ray that goes down by less than this per unit of length is not followed to a marker's depth, but to its nearest
    point."""
    unit: float = 0.25
    """Cosine and sine of the heading that a leaning marker's square asks for may miss the unit circle by this."""
    few_inflation: float = 4.0
    """Of the covariance of a picture with at most two markers as one of a series: what they leave open of the tilt,
    times the height, is alike for half a second, 15 pictures. Of 1, 2, 4, 8 and 16 the one with the least errors in
    flights over sheets half a metre apart; with 1, pictures of more markers are rejected after those of one. With more
    markers errors are alike, too, but a millimetre."""
    misfit_rms_px: float = 0.5
    """Corners are this far from where they belong on average only in thick haze, or when intrinsics or map are
    wrong."""
    max_pixel: float = 1e5
    """Pixels farther out than any image is large are garbage."""


MARKERS_POSE = MarkersPoseTuning()


@dataclass(frozen=True, slots=True)
class PnpTuning:
    steps: int = 10
    converged: float = 1e-3
    """Steps end when nothing moved by more than this [m, rad]. What is left is about its square, but for the tilt of
    few markers: corners weigh the more the better they fit, and after a step of 4 mrad ten may be left."""
    tilt_sigma_few_rad: float = 0.009
    """0.5 degrees: the AHRS's tilt as a prior when at most two markers are seen."""
    tilt_sigma_many_rad: float = 0.09
    """5 degrees otherwise: the AHRS's tilt error times the height would be worse than what many corners say."""
    few_points: int = 8
    shrink_px: float = 0.22
    shrink_sigma_px: float = 0.12
    """Prior of the distance by which corners are found inside of the true ones. Rendered images: 0.18 to 0.31 px at
    rest at 1.3 to 0.3 m, up to 0.5 px at 0.6 m/s; sharp corners: none. From frame to frame it spreads by 0.03 px."""
    min_scale: float = 0.5
    """Corners are at least this share of what is expected off, however well they fit."""
    prior_sigma_px: float = 0.12
    prior_count: float = 6.0
    """Standard deviation of a corner along one axis where the image did not tell, and how many residuals what is
    expected is worth: one marker's own residuals say little about it."""
    corner_sigmas: float = 3.0
    corner_floor: float = 2.5
    """Corners that lie further from their projection than this many of the image's standard deviations, and this many
    expected ones, are left out: occluded, at the laser dot, wrongly refined."""


PNP = PnpTuning()


@dataclass(frozen=True, slots=True)
class StampMonitorTuning:
    window_us: int = 2_000_000
    least_us: int = 600_000
    least_fixes: int = 12
    """Shorter windows are not used."""
    margin_us: int = 260_000
    """So long before its first fix a window needs inertial samples."""
    gap_us: int = 150_000
    """Inertial sensors that are silent for longer begin a new window."""
    evaluate_s: float = 0.5
    """How often all is added up, unless set otherwise;"""
    checks_soon: int = 30
    """while fixes miss with each of them, so many at most before the next that does not."""
    forget_s: float = 60.0
    """Older windows count for less."""
    alike: float = 4.0
    """Errors of fixes and of inertial sensors are alike over some moments: so many count as one."""
    floor_rad: float = 4e-4
    floor_m: float = 3e-4
    """What a window fits to at best."""
    far: float = 6.0
    """Times the median miss: such a fix is an outlier."""
    unexplained: float = 0.5
    """A window in which the inertial sensors leave this share of what fixes show, in squares, says nothing of
    stamps."""
    unfit_sigma: float = 4.9
    """A window fits worse than usual by chance once in so many standard deviations."""
    scale: float = 0.05
    """Share of what fixes show that errors of scale (gyro, accelerometer, lens) may leave: no reason to call it
    unfit."""
    newest: int = 3
    """So many outliers in a row that are the newest fixes are what begins to be otherwise."""
    usual_count: int = 9
    """Windows that tell how well they fit as a rule: their median. An offset that lasts is fitted after one of them."""
    lasts_us: int = 500_000
    lasts_s: float = 0.01
    """A delay is acted on once it has been found for so long, from window to window within this or three sigma,"""
    settled_count: int = 2
    """if so many windows have shown what is usual: stamps that are late from the start have not changed."""
    sure: float = 12.0
    """Difference of the logarithms of two likelihoods that is acted on: 4.9 sigma."""
    suspected: float = 4.0
    ahead_us: int = 200_000
    ahead_count: int = 10
    """Pictures in a row from a future that is nearer than this are stamped late. Others are garbage."""
    ahead_sigma_s: float = 0.02
    age_step_us: int = 30_000
    age_soon: int = 3
    age_count: int = 10
    """Pictures whose age at their arrival is off by so much have other stamps, or come later than they did: which of
    both is not known. From so many in a row on it is possible, and from so many evidence of before is of other
    stamps."""
    age_gain: float = 0.02
    """Of a new age in the usual one."""
    missed_us: int = 1_000_000
    """Fixes that have missed so long before the age was found to have changed missed for it."""
    suspect_us: int = 4_000_000
    """So long after such a step other sensors are not suspect for what stamps may have done."""
    apart_s: float = 0.001
    apart_first_s: float = 0.003
    """Smaller changes are not worth it; nor is a first one."""


STAMP_MONITOR = StampMonitorTuning()


@dataclass(frozen=True, slots=True)
class VisionTuning:
    hint_margin_px: float = 60.0
    hint_margin_m: float = 0.06
    """Markers so far outside of the predicted image (the larger one, seen on the floor) may be in view: some
    centimetres and degrees of error. Close to the floor a centimetre is many pixels."""
    most_expected: int = 64
    """Of an image with more only the middle is searched: time grows with their number, and a sighting holds 64."""
    many: int = 24
    """From so many expected markers on a few guides in the middle are detected, and tell where the others are,"""
    guides: int = 9
    """as many as this expected,"""
    least_guides: int = 4
    """and this found;"""
    placed_fit: float = 0.7
    """those others count of whose cells the correlation with the pattern is this high,"""
    placed_px: float = 2.5
    """and whose corners are no further from there;"""
    placed_rounds: int = 2
    """these in turn tell where the rest is,"""
    most_left: float = 0.5
    """and all markers are detected where, of those found so, more than this share is left."""
    middle: float = 0.5
    enough: int = 6
    """A quick search without a hint tries this share of the image's width and height first, and ends with so many
    markers."""
    window_px: int = 13
    """The one adaptive threshold window while tracking: about a quarter to a half of a marker's side."""
    acquire_windows_px: tuple[int, int, int] = (7, 31, 8)
    """First, last and step of the windows without a hint."""
    threshold_constant: float = 3.0
    """Instead of OpenCV's 7: finds markers that haze has left with little contrast."""
    min_otsu_std_dev: float = 2.0
    """Instead of OpenCV's 5, for the same reason."""
    hazy_std_dev: float = 24.0
    """An image whose grey levels spread by less than this standard deviation is hazy: a floor of markers has 74 in
    clear water, 32 at turbidity 1 1/m and 0.8 m, 15 at 2 1/m, 4 at 3 1/m and 1.2 m."""
    hazy_threshold_constant: float = 1.5
    hazy_min_otsu_std_dev: float = 1.0
    """Find all markers at 1 m and 3 1/m, where 3 and 2 find one in twenty; the smoothing keeps noise out."""
    hazy_smooth_px: tuple[tuple[float, int], tuple[float, int]] = ((4.5, 5), (3.2, 3))
    """Cell of the smallest marker from which on, and side of the Gaussian that smooths hazy images then: halves the
    error of the pose (5 against 10 mm at 1 m and 3 1/m). Smaller cells would flow into each other."""
    size_band: tuple[float, float] = (0.6, 1.6)
    """A marker's perimeter may differ by these factors from the predicted one."""
    min_side_px: float = 5.0
    """Smaller markers cannot be read."""
    half_cell_px: float = 6.5
    """Markers whose cells are at least so wide are looked for in the image at half its size."""
    correction: float = 0.6
    """Share of the misread cells that a dictionary's least distance would allow to correct which are corrected
    (OpenCV's own choice): 3 of 36 in tag36h11, 2 of 25 in tag25h9, none in DICT_4X4_1000."""
    second_windows_px: tuple[int, int, int] = (3, 23, 10)
    second_constant: float = 7.0
    """Windows and threshold constant of the second pass: OpenCV's own."""
    hazy_second_windows_px: tuple[int, int, int] = (7, 23, 16)
    """The same in a smoothed image."""
    border_px: float = 3.0
    """Corners nearer to the image's border are not taken (OpenCV's own choice)."""
    whole_px: float = 1.5
    """A marker should be found when its corners are predicted this far inside of the image."""
    least_fit: float = 0.4
    """Smallest correlation with the pattern of the decoded marker."""
    around: float = 0.75
    """The second pass takes in this share of the marker's size on each side,"""
    around_px: float = 8.0
    """and at least so many pixels: the white around it, and the error of the prediction."""
    most_areas: int = 12
    """More missing markers than these are searched in one region."""
    same: float = 0.5
    """Two markers of one id whose centres are nearer than this share of their side are one."""
    refine_cells: float = 0.72
    """Half width of the corner refinement window in cells of the marker, black border included: a wider window would be
    drawn to the next cell's corner."""
    refine_window_px: tuple[int, int] = (2, 5)


VISION = VisionTuning()


@dataclass(frozen=True, slots=True)
class SecondLookTuning:
    most: int = 64
    """Quadrilaterals that are read again in one image, for each dictionary: bounds what it costs."""
    least_fit: float = 0.75
    """Smallest correlation of the cells with the pattern."""
    least_rise: float = 0.25
    """Across each side it grows brighter by this share of white minus black."""
    chance: float = 1e-4
    """Of a random word to be read as a marker."""
    reach: float = 0.35
    """With a prediction, corners lie at most this share of the side from theirs, and the error of the prediction."""
    places: int = 8
    """Profiles across each side,"""
    steps: int = 9
    """so many pixels of each,"""
    across_cells: float = 0.9
    across_px: tuple[float, float] = (1.5, 4.0)
    """and how far they reach to both sides: cells, and bounds in pixels."""
    same: float = 0.5
    """Two markers whose centres are nearer than this share of their half are one."""


SECOND_LOOK = SecondLookTuning()


@dataclass(frozen=True, slots=True)
class ProcessNoiseTuning:
    """Constants of :mod:`autopilot.estimator.tuning`."""

    pos_noise: float = 2e-4
    """m/sqrt(s): keeps the position gain alive at rest."""
    gyro_noise: float = 1.1e-3
    """rad/s/sqrt(Hz): 0.05 deg/s/sqrt(Hz) of the IG-500 class, and a quarter more for scale error and misalignment."""
    accel_noise: float = 0.007
    """m/s^2/sqrt(Hz), north and east: sensor noise is a third of this, the rest is what tilt errors do within a
    second."""
    accel_noise_down: float = 0.005
    """m/s^2/sqrt(Hz), down: tilt errors leak in squared only."""
    gyro_bias_walk: float = 1e-4
    """rad/s/sqrt(s)"""
    current_walk: float = 0.02
    """m/s/sqrt(s): eddies that CURRENT_RATE does not describe."""
    current_rate_walk: float = 0.04
    """m/s^2/sqrt(s): with CURRENT_RATE_TIME_S a stationary 0.04 m/s^2. The jet crossed at cruise speed does twice that
    for a moment, but a larger value lets errors of the drag pass for current."""
    heading_offset_walk: float = 0.0087
    """rad/sqrt(s), 0.5 degrees: steel of a tank."""
    laser_bias_walk: float = 1e-3
    """m/sqrt(s)"""
    blind_gyro_noise: float = 0.2
    """rad/s/sqrt(Hz) when there is no gyro."""
    blind_accel_noise: float = 0.15
    """m/s^2/sqrt(Hz) when the vehicle model stands in for the accelerometer."""
    model_accel_noise: float = 0.04
    """m/s^2/sqrt(Hz) when the vehicle model is all there is: 0.03 m/s^2 that changes within a second, tether and
    jet."""
    tilted_gyro_noise: float = 0.01
    """rad/s/sqrt(Hz) when the accelerometer is suspect: its tilt may be wrong, and with it the axis of turning."""
    compass_noise: float = 0.03
    """rad/s/sqrt(Hz) when the turning is the AHRS heading's: its slow error of a degree and the steel of the tank."""
    coast_fraction: float = 0.5
    """Without vision current, drag and thrust cannot be told from the accelerometer's bias: their states wander by this
    share only. What the current may do unseen comes on top (:mod:`.water`)."""
    drag_walk: float = 0.004
    """1/sqrt(s): drag changes over minutes."""
    thrust_walk: float = 0.002
    """1/sqrt(s): mass and propellers change over longer still."""
    current_down_walk: float = 0.01
    """m/s/sqrt(s), when the vertical current is a state: half of the horizontal ones."""
    depth_offset_walk: float = 3e-4
    """m/sqrt(s): tides, weather and a warming sensor move the offset by a centimetre in a quarter of an hour."""


NOISE = ProcessNoiseTuning()
