//! `[live]`: the live view of a running robot.

hal::settings! {
    /// The live view of a running robot (docs/live-view.md).
    pub struct LiveSection {
        /// Unix socket at which the running robot serves the program `live-view`. If it is empty, there is none.
        socket: String = String::new();
        /// Most scans per second.
        scan_hz: f64 = 10.0, in 0.1..=100.0, unit "Hz";
        /// Most maps per second.
        map_hz: f64 = 2.0, in 0.1..=10.0, unit "Hz";
        /// Most camera images per second.
        camera_hz: f64 = 5.0, in 0.1..=60.0, unit "Hz";
        /// Most depth images per second.
        depth_hz: f64 = 2.0, in 0.1..=60.0, unit "Hz";
        /// Images with more columns are made smaller.
        image_columns: u32 = 640, in 64..=4096, unit "pixels";
        /// Quality of the images as JPEG.
        jpeg_quality: u8 = 70, in 1..=100;
        /// A robot that was watched pauses when no client has watched for this long, because the link is lost or the page is closed.
        /// It is noticed up to 4 s later if a client vanishes without closing its connection. 0: it goes on as it was ordered.
        pause_when_unwatched_s: f64 = 0.0, in 0.0..=86400.0, unit "s";
    }
}
