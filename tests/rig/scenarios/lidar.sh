#: title   the Hokuyo driver on the kernel's USB serial port
#: modules serial
#: seconds 180
# A name that is stable over a replug, as udev creates it.
mkdir -p /dev/serial/by-id && ln -s /dev/ttyUSB0 /dev/serial/by-id/usb-Hokuyo
"$HIL" rig-probe lidar --port /dev/serial/by-id/usb-Hokuyo --scanner /dev/ttyS1 --usb /sys/bus/usb/devices/1-1
