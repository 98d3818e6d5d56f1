"""Log the scores of runs to MLflow: python examples/mlflow_log.py runs/seen runs/other"""

import sys

import mlflow

from fbench.api.runs import open_run

for folder in sys.argv[1:]:
    run = open_run(folder)
    manifest, scores = run.run.manifest, run.scores()
    shown = scores[(scores["slice"] == "all") & scores["value"].notna()]
    with mlflow.start_run(run_name=f"{manifest.log.name} {manifest.pipeline}"):
        mlflow.log_params({"log": manifest.log.name, "pipeline": manifest.pipeline, "digest": manifest.digest})
        mlflow.log_metrics({f"{row.metric}/{row[2]}": row.value for row in shown.itertuples()})
        mlflow.log_artifact(str(run.folder / "scores.json"))
