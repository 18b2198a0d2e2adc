# bash plant.sh PORT '{"command": ...}': one command to the control port of the emulated PLC, and its answer.
exec 3<>"/dev/tcp/127.0.0.1/$1"
echo "$2" >&3
head -n 1 <&3
sleep 0.2   # until the PLC's program and the HMI show it
