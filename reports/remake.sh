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
rm -rf "$here/figures" "$here"/*.{csv,html,json,tex,txt}
cp -r out/figures out/report.html out/*.{csv,json,tex} "$here/"
rm "$here/manifest.json" "$here/assessment.json"
sed -n '/Truth against posterior/,$p' demo.log > "$here/truth.txt"
