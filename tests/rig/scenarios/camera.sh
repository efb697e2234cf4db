#: title   the camera driver at the kernel's V4L2 (vivid)
#: modules video
#: seconds 180
# A name that stays the same over a replug, as udev makes it.
mkdir -p /dev/v4l/by-id && ln -s /dev/video0 /dev/v4l/by-id/rig
camera_loop
"$HIL" rig-probe camera --device /dev/v4l/by-id/rig --planes /dev/video2
