"""The logs: how each is made, from which repository, and what is known of it beforehand."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from benchmarks.public_logs import (
    bags,
    bus_recordings,
    loggers,
    phones,
    pocket_phones,
    race_cars,
    repositories,
    robots,
    tensors,
    vehicles,
)
from benchmarks.public_logs.frames import BusRecording, Message
from benchmarks.public_logs.repositories import Repository

RIGHT = Path(__file__).parent / "right"


@dataclass(frozen=True)
class PublicLog:
    """One log. right: its configuration by hand. known: (angle about x, y, z or None) [deg], +-."""

    name: str
    repository: Repository
    convert: Callable[[Path], list[Message] | BusRecording]
    known: tuple[float | None, float | None, float | None] = (None, None, None)
    within: float = 0.0
    right: str = ""

    @property
    def configuration(self) -> Path:
        """The configuration by hand; it names its database `car.dbc`."""
        return RIGHT / f"{self.right or self.name}.yaml"


LOGS = (
    # pitch and yaw as its author's own filter was told them; roll was not estimated there
    PublicLog("everett_roof", repositories.EVERETT, vehicles.everett_roof, (None, -6.76, 174.61),
              1.0),
    PublicLog("austin_bmw", repositories.CLOUDPOSE, phones.austin_bmw),
    PublicLog("dresden_city", repositories.BALZER, vehicles.dresden_city),
    # the logger's box is aligned with the car by whoever mounts it; forward, right, down
    PublicLog("tcr_civic", repositories.XDRK, vehicles.tcr_civic, (180.0, 0.0, 0.0), 3.0),
    PublicLog("shuttle_1", repositories.VEHSENSE, partial(phones.paratransit_shuttle, part=0),
              right="shuttle"),
    PublicLog("shuttle_2", repositories.VEHSENSE, partial(phones.paratransit_shuttle, part=1),
              right="shuttle"),
    # stated with its solution: x right, y forward
    PublicLog("dtu_ugv", repositories.DTU, vehicles.dtu_ugv, (0.0, 0.0, -90.0), 3.0),
    PublicLog("phone_s24", repositories.SANTOLLAN, phones.phone_s24),
    PublicLog("pixel_1hz", repositories.BRODOVSKY, phones.pixel_1hz),
    # from here on: the second search
    # by its gravity, its turns and its braking: about the z axis by half a turn
    PublicLog("jeddah_hour", repositories.KAU, partial(vehicles.jeddah_car, drive="uni_home"),
              (0.0, 0.0, 180.0), 5.0, right="jeddah_car"),
    PublicLog("jeddah_harsh", repositories.KAU, partial(vehicles.jeddah_car, drive="harsh_data"),
              (0.0, 0.0, 180.0), 5.0, right="jeddah_car"),
    # stated with the data: forward, right, down
    PublicLog("comma_rav4", repositories.COMMA2K19, vehicles.comma_rav4, (180.0, 0.0, 0.0), 6.0),
    PublicLog("provo_scooter", repositories.ESCOOTER, phones.provo_scooter),
    PublicLog("doha_iphone", repositories.ROAD_SURFACE, phones.doha_iphone),
    PublicLog("helbert_c1", repositories.INGENIEUR, phones.helbert_c1),
    # its test sends this rotation beside the bag
    PublicLog("husky_field", repositories.ROBOT_LOCALIZATION, bags.husky_field,
              (90.0, 0.0, -90.0), 6.0),
    # levelled axes: forward, left, up
    PublicLog("kitti_0042", repositories.ODOMETRY_FUSION, bags.kitti_0042, (0.0, 0.0, 0.0), 2.0),
    # from here on: the third search
    PublicLog("css_165", repositories.CSS, bus_recordings.css_165),
    # an INS beside it: forward is y
    PublicLog("toronto_sienna", repositories.TORONTO_IMU, vehicles.toronto_sienna,
              (None, None, -90.0), 2.0),
    PublicLog("pittsburgh_1", repositories.POTHOLES, partial(phones.pittsburgh, trips=(1,)),
              right="pittsburgh"),
    PublicLog("pittsburgh_2", repositories.POTHOLES,
              partial(phones.pittsburgh, trips=(2, 3, 4, 5)), right="pittsburgh"),
    # from here on: the fourth search
    # by its gravity, its turns and its braking
    PublicLog("boston_town", repositories.NORTHEASTERN, bags.boston_town, (178.4, -0.9, 8.0), 2.0),
    PublicLog("taupo_box", repositories.RACECHRONO,
              partial(race_cars.taupo_lap, sensors=race_cars.BOX), (-0.3, -4.2, 2.8), 2.0,
              right="taupo_lap"),
    PublicLog("taupo_phone", repositories.RACECHRONO,
              partial(race_cars.taupo_lap, sensors=race_cars.PHONE), (3.6, 73.7, -168.3), 3.0,
              right="taupo_lap"),
    # the vehicle's own axes: forward and left
    PublicLog("targa_250lm", repositories.REVS, race_cars.targa_250lm, (None, None, 0.0), 1.0),
    # turned about by hand: no mount to be known
    PublicLog("pune_phone", repositories.PUNE, phones.pune_phone),
    # it leans
    PublicLog("dresden_motorbike", repositories.BALZER, phones.dresden_motorbike),
    # from here on: the fifth search
    # by its braking and its turns; its gravity is 12 % small, so the tilt is not known well
    PublicLog("sonoma_car", repositories.RACECAPTURE, race_cars.sonoma_car, (11.0, 6.0, -86.5),
              5.0),
    # the box wanders
    PublicLog("seattle_car", repositories.RACECAPTURE, race_cars.seattle_car),
    # the vehicle's own axes: forward and left
    PublicLog("genesis_slow", repositories.GENESIS, partial(vehicles.genesis_lap, lap="slow"),
              (None, None, 0.0), 2.0, right="genesis"),
    PublicLog("genesis_fast", repositories.GENESIS, partial(vehicles.genesis_lap, lap="fast"),
              (None, None, 0.0), 2.0, right="genesis"),
    # the unit's axes are the car's to within a degree; then turned by what is stated here
    PublicLog("kitti_0028_turned", repositories.KITTI_TENSORS,
              partial(tensors.kitti_raw, drive="2011_09_30_drive_0028",
                      turned=(24.0, -13.0, 141.0)),
              (24.0, -13.0, 141.0), 2.0, right="kitti_raw"),
    PublicLog("kitti_0034", repositories.KITTI_TENSORS,
              partial(tensors.kitti_raw, drive="2011_10_03_drive_0034"), (0.0, 0.0, 0.0), 2.0,
              right="kitti_raw"),
    # in a pocket: it is turned about on the way
    PublicLog("amsterdam_bus", repositories.AMSTERDAM,
              partial(pocket_phones.phyphox, repository=repositories.AMSTERDAM,
                      folder=pocket_phones.BUS), right="amsterdam"),
    PublicLog("amsterdam_car", repositories.AMSTERDAM,
              partial(pocket_phones.phyphox, repository=repositories.AMSTERDAM,
                      folder=pocket_phones.CAR), right="amsterdam"),
    PublicLog("amsterdam_motorway", repositories.AMSTERDAM,
              partial(pocket_phones.phyphox, repository=repositories.AMSTERDAM,
                      folder=pocket_phones.MOTORWAY), right="amsterdam"),
    # from here on: the sixth search
    # by its gravity, its turns and its braking; the phone leans about
    PublicLog("rome_904", repositories.ROME, partial(loggers.rome, drive=904),
              (80.7, 0.0, -104.0), 12.0, right="rome"),
    PublicLog("rome_906", repositories.ROME, partial(loggers.rome, drive=906),
              (76.7, -2.6, -98.6), 3.0, right="rome"),
    PublicLog("rome_908", repositories.ROME, partial(loggers.rome, drive=908),
              (55.5, -0.8, -95.4), 3.5, right="rome"),
    PublicLog("rome_909", repositories.ROME, partial(loggers.rome, drive=909),
              (73.7, -1.9, -94.5), 3.5, right="rome"),
    # gravity is taken out: the two level axes alone
    PublicLog("lausitz_track", repositories.TRACKADDICT, loggers.lausitz_track,
              (None, None, -1.2), 2.0),
    # in the hand at stops
    PublicLog("klang_car", repositories.KLANG, loggers.klang_car, (59.6, -6.0, -90.3), 12.0),
    # what it measured at its start is taken out: no mount to be known
    PublicLog("sydney_audi", repositories.FREEMATICS, loggers.sydney_audi),
    PublicLog("boston_1hz", repositories.BOSTON_1HZ, loggers.boston_1hz, (-178.3, -3.3, -0.3),
              5.0, right="boston_vectornav"),
    # in circles: no yaw to be known
    PublicLog("boston_circles", repositories.BOSTON_CIRCLES, loggers.boston_circles,
              (180.0, 1.8, None), 3.0, right="boston_vectornav"),
    # from here on: the eighth search; by gravity, turns and changes of speed
    PublicLog("kia_5hz", repositories.CSS_2026, bus_recordings.kia_5hz, (-6.1, -4.4, 17.0), 6.0),
    PublicLog("kia_10hz", repositories.CSS_PARQUET, bus_recordings.kia_10hz, (2.0, 1.7, 2.9), 2.0),
    PublicLog("kia_car_park", repositories.CSS_2026, bus_recordings.kia_car_park,
              (1.6, 1.4, 12.0), 8.0),
    PublicLog("racer_2", repositories.FRICTION_MAPS, partial(robots.racer, run=2),
              (3.5, 0.0, 92.0), 4.0, right="racer"),
    PublicLog("racer_3", repositories.FRICTION_MAPS, partial(robots.racer, run=3),
              (3.3, 0.9, 89.0), 4.0, right="racer"),
    # its yaw shows in nothing; stated as 0
    PublicLog("mars_yard", repositories.NAVEGO, robots.mars_yard, (179.5, -1.5, None), 3.0),
    # with the slopes that its heights show; 12 was written down, without them
    PublicLog("skoda_receiver", repositories.WHEEL_INERTIAL, robots.skoda_receiver,
              (0.7, 3.4, -1.0), 6.0),
    PublicLog("skoda_dot", repositories.WHEEL_INERTIAL, robots.skoda_dot, (-4.8, 1.9, -84.0),
              10.0),
    # from here on: the ninth search; by gravity, turns and changes of speed
    PublicLog("montreal_cup", repositories.MONTREAL,
              partial(pocket_phones.phyphox, repository=repositories.MONTREAL, folder="Data"),
              (54.7, -0.3, -93.5), 3.0, right="amsterdam"),
    *(
        PublicLog(f"gyor_{i}", repositories.GYOR,
                  partial(pocket_phones.phyphox, repository=repositories.GYOR,
                          folder=f"data/raw_data_train/{folder}"),
                  known, within, right="amsterdam")
        for i, (folder, known, within) in enumerate((
            ("rsq_q1/00", (-1.6, -0.6, -89.8), 2.5),
            ("rsq_q2/00", (-1.1, 2.9, -85.5), 5.0),
            ("rsq_q2/01", (-1.6, 1.0, -86.5), 5.0),
            ("rsq_q3/00", (-1.0, 0.0, -86.0), 5.0),
            ("rsq_q3/01", (-1.9, 0.1, -92.0), 8.0),
            ("rsq_q3/02", (-1.3, -0.1, -88.0), 10.0),
            ("test/00", (-1.6, 0.8, -92.3), 2.5),
        ), 1)
    ),
    PublicLog("boston_drive", repositories.BOSTON_DRIVE, loggers.boston_drive,
              (-178.2, 1.0, 0.8), 2.5, right="boston_vectornav"),
    # it leans
    PublicLog("bremen_bicycle", repositories.BREMEN, robots.bremen_bicycle),
)  # fmt: skip
