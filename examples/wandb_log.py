"""Log the scores of runs to Weights & Biases: python examples/wandb_log.py runs/seen runs/other"""

import sys

import wandb

from fbench.api.runs import open_run

for folder in sys.argv[1:]:
    run = open_run(folder)
    manifest, scores = run.run.manifest, run.scores()
    shown = scores[(scores["slice"] == "all") & scores["value"].notna()]
    about = {"log": manifest.log.name, "pipeline": manifest.pipeline, "digest": manifest.digest}
    with wandb.init(project="fbench", name=f"{manifest.log.name} {manifest.pipeline}", config=about) as logged:
        logged.log({f"{row.metric}/{row[2]}": row.value for row in shown.itertuples()})
        logged.save(str(run.folder / "scores.json"), base_path=str(run.folder))
