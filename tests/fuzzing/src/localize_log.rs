use firmware_host::localize::log::Log;

/// Arbitrary text as the log of another robot: it is refused with a line that exists, or every pose is finite and every scan has
/// the beams of the geometry.
pub fn localize_log(data: &[u8]) {
    let lines = data.split(|byte| *byte == b'\n').count();
    match Log::parse(data) {
        Ok(None) => {}
        Ok(Some(log)) => {
            assert!(log.lines.len() <= lines);
            assert!(log.lines.iter().any(|line| line.ranges.is_some()));
            for line in &log.lines {
                assert!(line.wheel.is_finite() && line.time_s.is_finite());
                assert!(line.ranges.as_ref().is_none_or(|all| all.len() == log.geometry.beams));
            }
        }
        Err(bad) => {
            assert!((1..=lines).contains(&bad.line) && !bad.reason.is_empty());
        }
    }
}
