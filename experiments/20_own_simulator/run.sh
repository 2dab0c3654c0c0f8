#!/usr/bin/env bash
# From logs to MJCF, five robots, each command with its time: run.sh FOLDER SO101.xml. `hybrid-id` is on the path.
set -u
here=$(cd "$(dirname "$0")" && pwd)
so101=$(realpath "$2")
mkdir -p "$1" && cd "$1" || exit 2
TIMEFORMAT='[%U s of processor time, %R s of wall time]'
step() { echo; echo "\$ $*"; time "$@"; }

[ -d cobot ] || python "$here/robots.py" . --so101 "$so101"
[ -f sheet.yaml ] || printf 'gear_ratio: 50\ntorque_constant: 0.03\nresistance: 2.0\nvoltage: 24\n' > sheet.yaml
for robot in ${ROBOTS:-lift servo band arm cobot}; do
  sheet=(); [ $robot = lift ] && sheet=(--motor sheet.yaml)
  step hybrid-id init $robot --robot $robot.xml "${sheet[@]}" --force
  step hybrid-id check $robot
  step hybrid-id identify $robot --pooled --out runs/$robot --force
  rm -f ${robot}_*.xml ${robot}_*.json ${robot}_*.html
  if [ $robot = arm ]; then
    cp arm.xml arm_nominal.xml
    sed 's|^components:|&\n  - {place: wrist_roll/load, kind: payload, options: {point: gripperframe}, parameters: {m_l: 0.05}}|' \
      arm/model.yaml > arm/loaded.yaml
    step hybrid-id identify arm --model arm/loaded.yaml --pooled --out runs/arm_loaded --force
    step hybrid-id export runs/arm --to mjcf --out arm_refit.xml --check arm
    step hybrid-id export runs/arm_loaded --to mjcf --out arm_corrected.xml --check arm
    step python "$here/unseen.py" arm arm_unseen arm_nominal.xml arm_refit.xml arm_corrected.xml
  else
    step hybrid-id diagnose $robot --out runs/${robot}_gap --force
    step hybrid-id export $robot --to mjcf --out ${robot}_nominal.xml
    step hybrid-id export runs/${robot}_gap/refit.yaml --to mjcf --out ${robot}_refit.xml --check $robot
    step hybrid-id export runs/${robot}_gap --to mjcf --out ${robot}_corrected.xml --check $robot
    step python "$here/unseen.py" $robot ${robot}_unseen $(ls -tr ${robot}_*.xml)  # one that is refused is not there
  fi
done
