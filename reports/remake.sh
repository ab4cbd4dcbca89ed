#!/usr/bin/env bash
# Remake this folder: the report, figures and tables of the full demo (some minutes on two cores).
#     reports/remake.sh [path of mfd-bayes]
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
command=$(realpath "${1:-$(command -v mfd-bayes)}")
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work"
"$command" demo out | tee "$work/demo.log"
rm -rf "$here/figures" "$here"/*.csv "$here"/*.html "$here"/*.txt
cp -r out/figures out/report.html out/parameters.csv out/derived.csv out/laws.csv out/law_scores.csv out/checks.csv out/scores.csv "$here/"
sed -n '/Truth against posterior/,$p' demo.log > "$here/truth.txt"
