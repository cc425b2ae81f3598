"""What once came from outside and broke the service, and the tests that do it again."""

from tests.bench.faults.finding import Finding

SYSTEM, SERVICE = "tests/system/test_", "tests/service/test_"
TRANSPORT, GUARD, PLANS = f"{SYSTEM}transport.py", f"{SERVICE}guard.py", f"{SYSTEM}plan_rule.py"
REAL_TIME, FAULTY_SENSORS, BESIDE = f"{SYSTEM}real_time.py", f"{SYSTEM}sensor_faults.py", f"{SERVICE}beside.py"

_HONEST = "inside 3 sigma, no contact, health says so within 1 s"


def _tested(part: str, name: str, before: str, promise: str, *tests: str) -> Finding:
    """``tests``: a file and, separated by a space, functions of it."""
    nodes = [f"{file}::{one}" if one else file for file, *ones in map(str.split, tests) for one in ones or ("",)]
    return Finding(part=part, name=name, before=before, promise=promise, tests=tuple(nodes))


TESTED: tuple[Finding, ...] = (
    _tested(
        "link",
        "floods of 0xFE, 0xFD and random bytes on UDP, TCP and a serial line",
        "one heartbeat in 8 s",
        "flooder named, others served",
        f"{TRANSPORT} test_a_flood_is_named_to_the_others_and_they_are_served",
    ),
    _tested(
        "link",
        "floods of valid messages and of junk that must be searched",
        "not measured",
        "a bounded amount of work, flooder named, others served at once",
        "tests/mavlink/test_intake.py test_a_flood_is_throttled_and_named_and_others_are_served_at_once "
        "test_whatever_comes_costs_a_bounded_amount_of_work",
    ),
    _tested(
        "link",
        "500 items up and down, a client that answers at once",
        "5.3 to 5.8 s each way",
        "items are exchanged between the ticks",
        f"{TRANSPORT} test_a_transfer_goes_on_between_ticks_and_is_logged",
    ),
    _tested(
        "link",
        "two clients, also with the same ids, upload on one port at once",
        "both ACCEPTED, 17 + 23 items mixed",
        "one ACCEPTED, one DENIED, the accepted plan in force",
        "tests/mavlink/test_intake.py test_two_clients_with_the_same_ids_do_not_mix",
        "tests/mavlink/test_missions.py test_a_second_client_is_denied_and_the_first_goes_on",
    ),
    _tested(
        "link",
        "another address sends a forced disarm to the socket of udpout",
        "disarmed a flying vehicle",
        "not heard; nothing open beyond the loopback",
        f"{TRANSPORT} test_a_stranger_is_not_heard_on_udpout",
        "tests/drivers/test_links.py test_nothing_is_open_beyond_the_loopback_unless_it_is_asked_for",
    ),
    _tested(
        "link",
        "the device of a serial link goes and comes back",
        "link silent for good",
        "reported once, used again",
        f"{TRANSPORT} test_a_serial_link_that_goes_is_named_once_and_comes_back",
    ),
    _tested(
        "link",
        "certificates of terminal regions as STATUSTEXT",
        '"Item 1: alpha 0.443 (0.047 m, 8.6 deg) by acceptance heading, 0 of 20000 violate"',
        "in the log, not on the operator's screen",
        f"{SYSTEM}operator_texts.py test_a_flight_says_nothing_that_is_for_the_log_only",
    ),
    _tested(
        "exchange",
        "uploads and downloads; 20 % of the datagrams lost, 20 % twice, 20 % late, both ways",
        "not measured",
        "all taken as sent",
        "tests/client/test_client_session.py test_plans_arrive_whole_over_a_link_that_loses_doubles_and_swaps",
    ),
    _tested(
        "exchange",
        "a line of 57,600 baud, all streams at 50 Hz, the parameter list and a plan asked for",
        "not measured",
        "commands answered within 300 ms, heartbeats <= 1.25 s apart",
        f"{SYSTEM}slow_line.py",
    ),
    _tested(
        "plans",
        "mission into an obstacle, then its fence, then rally points, as a ground station sends them",
        "fence refused; armed, flew the mission unfenced into the obstacle and pushed",
        "stored and reported; no arming, no start by any way",
        f"{PLANS} test_a_mission_into_an_obstacle_in_the_order_of_a_ground_station",
    ),
    _tested(
        "plans",
        "the fence of a flying vehicle is removed, or laid over its mission",
        "removal accepted in silence",
        "refused, the mission goes on fenced",
        f"{PLANS} test_an_armed_vehicle_keeps_its_fence",
    ),
    _tested(
        "plans",
        "a parameter in flight that forbids the mission (DEPTH_MAX)",
        "flown on",
        "holds at once, does not resume before it is fixed",
        f"{PLANS} test_parameters_in_flight_and_on_the_ground",
    ),
    _tested(
        "plans",
        "a submerged vehicle and a ground station that arms on the ground and pauses in the air",
        "always in the air: neither Arm nor Start Mission",
        "on the ground until it is sent somewhere",
        f"{PLANS} test_a_submerged_vehicle_from_arming_to_landing_with_what_a_ground_station_offers",
    ),
    _tested(
        "plans",
        "mission upload of a plan that does not fit together",
        "the part that came second was refused, exit code 1",
        "exit code 3 and the reason, as from mission check",
        "tests/client/test_mission_command.py "
        "test_a_plan_that_does_not_fit_together_is_stored_and_the_exit_code_says_so test_check_shows_every_problem",
    ),
    _tested(
        "beside",
        "flights in the paper's tank by either cost: whose thread does the slow work",
        "routes and certificates on the loop's",
        "none of it on the loop's thread",
        f"{BESIDE} test_nothing_slow_runs_on_the_thread_of_the_loop",
    ),
    _tested(
        "beside",
        "12 go-tos 0.1 s apart, least energy",
        "all are planned, the last is answered after 12 plan times",
        "only the last is planned to its end",
        f"{BESIDE} test_of_many_go_tos_only_the_last_is_planned_to_its_end",
    ),
    _tested(
        "beside",
        "the energy planner raises at every request",
        "the exception ends the service",
        "reported once, and flown by the plain route",
        f"{BESIDE} test_a_planner_that_fails_costs_the_trajectory_and_not_the_service",
    ),
    _tested(
        "estimator",
        "accelerometer off by 1 and 10 m/s2, gyro and tilt wrong in a marker gap of 3 s",
        "4.9 m off with 0.18 m claimed, GOOD, 3 contacts; at 10 m/s2 the process ended",
        f"{_HONEST}; thrusters and commands are not blamed",
        f"{FAULTY_SENSORS} test_the_estimate_does_not_believe_what_its_evidence_denies",
    ),
    _tested(
        "estimator",
        "all markers moved by 0.3 m, focal length 10 % off in flight",
        "height 28.5 mm off at 3 %, NEES 37,600, nothing reported",
        f"reported; {_HONEST}",
        f"{FAULTY_SENSORS} test_moved_markers_are_told_and_a_wrong_lens_shows_in_sigma",
    ),
    _tested(
        "machine",
        "start of `autopilot sitl` to the first HEARTBEAT",
        "1.6 to 2.2 s of CPU time, links opened last",
        "1 s of CPU time",
        f"{SYSTEM}start.py test_a_station_that_only_listens_hears_it_as_early",
    ),
    _tested(
        "machine",
        "the service gets no processor while clients exchange and watch",
        '"silent for 10 s": the demo failed in two of three tries',
        "clients wait while the process lives",
        f"{SYSTEM}busy_machine.py",
    ),
    _tested(
        "machine",
        "a service is started in a folder with a mission.py, drivers.py, sitl.py",
        "the user's mission.py was imported",
        "runs",
        f"{SYSTEM}children.py test_a_service_is_started_in_a_folder_with_modules_of_our_names",
    ),
    _tested(
        "machine",
        "revision of a package inside somebody's repository",
        "the commit of that repository",
        "none",
        f"{SERVICE}provenance.py test_somebody_elses_repository_is_not_ours",
    ),
    _tested(
        "machine",
        "SITL with a pillar on the way that the fence does not have",
        "silent console, exit code 0",
        "warning, contacts counted, exit code 3",
        f"{SYSTEM}sitl_console.py test_contacts_are_shown_counted_and_in_the_exit_code",
    ),
    _tested(
        "machine",
        "a request that is refused again and again",
        "every repeat was said",
        "each text once in 5 s, every command answered",
        f"{SYSTEM}operator_texts.py test_a_reason_is_said_once_and_every_command_is_answered",
    ),
    _tested(
        "guard",
        "the controller raises an exception in flight",
        "process ended",
        "station keeping for FS_FAULT_TIME, then neutral; armed, reported, heartbeats go on",
        f"{GUARD} test_a_controller_that_fails_is_replaced_by_station_keeping_then_by_neutral",
    ),
    _tested(
        "guard",
        "estimator, commander or allocation raise the same exception again and again",
        "process ended",
        "the second disarms; heartbeats go on",
        f"{GUARD} test_a_part_that_goes_on_failing_disarms_and_the_rest_goes_on",
    ),
    _tested(
        "guard",
        "the handler of a command raises an exception",
        "process ended",
        "answered FAILED, nothing else changes",
        f"{GUARD} test_a_message_that_cannot_be_handled_is_answered_and_nothing_else_happens",
    ),
    _tested(
        "guard",
        "sensors' serial line gone for 1.5 s (DriverError, OSError out of poll)",
        "process ended",
        "reported, AHRS failsafe, tried again",
        f"{GUARD} test_sensors_that_disappear_are_said_and_come_back",
    ),
    _tested(
        "guard",
        "thruster writes that fail once, and for long",
        "process ended",
        "neutral tried, reported, the next write counts; thruster failsafe (FS_THR_ACT)",
        f"{GUARD} test_one_failed_thruster_write_is_said_and_the_next_succeeds "
        "test_a_thruster_output_that_stays_away_is_a_failsafe test_after_a_failed_write_neutral_is_tried",
    ),
    _tested(
        "guard",
        "DO_SET_HOME at 20, -160 and other far places",
        "process ended (ConfigError), or accepted and shown elsewhere",
        "refused beyond 10 km, with distance and remedy",
        f"{SERVICE}far_places.py",
    ),
    _tested(
        "guard",
        "accelerometer offset 10 m/s2 in a gap of 4 s",
        "process ended (OverflowError, DEBUG_VECT margin_m = -2e68)",
        "goes on",
        f"{SERVICE}wild_sensors.py",
    ),
    _tested(
        "loop",
        "a detector that takes 150 ms per picture",
        "3 s took 15 s",
        "the newest picture wins, the loop waits for none",
        f"{REAL_TIME} test_a_slow_detector_does_not_hold_the_loop",
    ),
    _tested(
        "loop",
        "a disk that takes 1 s to make a file and 1 s to finish it",
        "stalls the run",
        "no tick waits, nothing of the first moments is lost",
        f"{REAL_TIME} test_a_slow_disk_does_not_hold_the_loop_and_nothing_of_the_first_moments_is_lost",
    ),
    _tested(
        "loop",
        "log folder gone at arming",
        "LogError ends the process, nothing is said in flight",
        "flies on, says so at once",
        f"{REAL_TIME} test_a_log_folder_that_is_gone_is_said_at_once_and_tried_again",
    ),
    _tested(
        "loop",
        "disk full",
        "LogError ends the process, exit code 1",
        "flies on to the end, exit code 3",
        f"{REAL_TIME} test_a_disk_that_is_full_ends_the_log_and_not_the_run",
    ),
    _tested(
        "loop",
        "service killed and started again",
        "all plans are gone",
        "--keep-plans: plans are what they were",
        f"{SYSTEM}restart.py test_a_killed_service_comes_up_with_what_it_had",
    ),
)
