"""Examples at the end of each ``--help``, by verb. A test parses every line."""

from typing import Final

EXAMPLES: Final[dict[tuple[str, ...], tuple[str, ...]]] = {
    (): (
        "hapticnet doctor",
        "hapticnet demo",
        "hapticnet slave --scene paper:1",
        "hapticnet master --record run.mcap",
        "hapticnet master --help",
    ),
    ("sweep",): (
        "hapticnet sweep studies/rate-distortion.toml --out-dir results/rates",
        "hapticnet sweep show results/rates --plot rates.png",
    ),
    ("sweep", "run"): (
        "hapticnet sweep run studies/rate-distortion.toml --out-dir results/rates",
        "hapticnet sweep run studies/repair.toml --out-dir results/repair --scheduler tcp://192.0.2.7:8786",
    ),
    ("sweep", "show"): (
        "hapticnet sweep show results/rates",
        "hapticnet sweep show results/rates --by codec,multiplier --of felt_rmse_n --where 'delay_ms = 25'",
        "hapticnet sweep show results/rates --x packets_per_s --y felt_rms_jnd --line codec --plot rates.pdf",
    ),
    ("scene",): ("hapticnet scene show paper:1",),
    ("device",): ("hapticnet device find", "hapticnet device step sim:0.6"),
    ("key",): ("hapticnet key new", "hapticnet key public"),
    ("demo",): (
        "hapticnet demo",
        "hapticnet demo --page",
        "hapticnet demo --insertions 1 --codec adaptive-predictive --out-dir results/mine",
    ),
    ("gallery",): ("hapticnet gallery", "hapticnet gallery --page 127.0.0.1:8080"),
    ("slave",): (
        "hapticnet slave",
        "hapticnet slave --scene my.toml --record-dir recordings",
        "hapticnet slave --listen 0.0.0.0:47800 --key key.toml --masters masters.toml",
    ),
    ("master",): (
        "hapticnet master",
        "hapticnet master --codec adaptive-predictive --multiplier 2 --record run.mcap",
        "hapticnet master --connect 192.0.2.7:47800 --peer-key KEY --device serial:auto --profile device.toml",
        "hapticnet master --operator trace:hand.csv --device none --json >report.json",
        "hapticnet master --law study/participants/03.toml",
        "hapticnet master --config rig.toml --codec raw",
    ),
    ("compare",): (
        "hapticnet compare",
        "hapticnet compare force.csv --force-column fx,fy,fz --position-column x,y,z --plot-dir figures",
        "hapticnet compare force.npy --force-column 2 --sampling-rate 1000 --loss 5% --codecs 'deadband;raw' --json",
    ),
    ("stability",): (
        "hapticnet stability",
        "hapticnet stability --hand finger,device-mass=0.1,max-force=3.3 --codec motion-predictive --loss 5%",
        "hapticnet stability --scene example-viscous --delays 20ms,60ms --coupling energy-bounded --plot map.png",
    ),
    ("info",): ("hapticnet info run.mcap", "hapticnet info run.csv --json"),
    ("export",): (
        "hapticnet export run.mcap.unfinished",
        "hapticnet export run.mcap --format csv",
        "hapticnet export run.csv --format npz --out arrays.npz",
    ),
    ("replay",): (
        "hapticnet replay run.mcap",
        "hapticnet replay deadband.mcap raw.mcap --speed 0.5 --loop",
        "hapticnet replay force.csv --force-column fz --position-column z --page 0.0.0.0:47880",
    ),
    ("codecs",): ("hapticnet codecs", "hapticnet codecs --json"),
    ("doctor",): ("hapticnet doctor", "hapticnet doctor --quick"),
    ("scene", "show"): ("hapticnet scene show paper:1", "hapticnet scene show my.toml --json"),
    ("device", "find"): ("hapticnet device find",),
    ("device", "info"): ("hapticnet device info serial:auto",),
    ("device", "calibrate"): ("hapticnet device calibrate serial:auto",),
    ("device", "tune"): ("hapticnet device tune serial:auto --profile device.toml",),
    ("device", "step"): (
        "hapticnet device step sim:0.6",
        "hapticnet device step serial:auto --profile device.toml --from 0.5 --to 2 --plot step.png",
    ),
    ("device", "new"): ("hapticnet device new my-motor",),
    ("device", "sim"): ("hapticnet device sim",),
    ("key", "new"): ("hapticnet key new", "hapticnet key new --name finger"),
    ("key", "public"): ("hapticnet key public",),
}
