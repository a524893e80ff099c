# pair.sh CASES SEEDS CELL TAG
. /work/h/scratch_trust/env.sh
for v in main new; do
 if [ $v = main ]; then export PYTHONPATH=/work/main/src:/work/main:/work/h/scratch_trust; cd /work/main; else export PYTHONPATH=/work/h/trust/src:/work/h/trust:/work/h/scratch_trust; cd /work/h/trust; fi
 nice /work/main/.venv/bin/python /work/h/scratch_trust/lab.py $1 $2 $3 /work/h/scratch_trust/$4_$v.jsonl > /work/h/scratch_trust/$4_$v.txt 2>&1
done
