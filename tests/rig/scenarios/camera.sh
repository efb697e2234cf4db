#: title   the camera driver on the kernel's V4L2 (vivid)
#: modules video
#: seconds 180
# A name that is stable over a replug, as udev creates it.
mkdir -p /dev/v4l/by-id && ln -s /dev/video0 /dev/v4l/by-id/rig
camera_loop
"$HIL" rig-probe camera --device /dev/v4l/by-id/rig --planes /dev/video2
