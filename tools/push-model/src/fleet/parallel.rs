//! A bounded number of robots at once: most of the time, each one is waited for.

use std::sync::mpsc::sync_channel;

use anyhow::{Context, Result};

/// Does `work` for all names, for at most `most` at once, each on its own thread. `begin` is called before and `done` after the work
/// for a name, on this thread; work for which `begin` returns `false` is left out. After the first error no work is begun; what runs
/// is waited for.
///
/// # Errors
/// The first error of `begin` or `done`.
pub fn in_parallel<S, T: Send>(
    names: Vec<String>,
    most: usize,
    state: &mut S,
    mut begin: impl FnMut(&mut S, &str) -> Result<bool>,
    work: impl Fn(&str) -> T + Sync,
    mut done: impl FnMut(&mut S, &str, T) -> Result<()>,
) -> Result<()> {
    let (sender, results) = sync_channel(most);
    let work = &work;
    std::thread::scope(|scope| {
        let mut names = names.into_iter();
        let mut running = 0;
        let mut outcome = Ok(());
        loop {
            while running < most && outcome.is_ok() {
                let Some(name) = names.next() else { break };
                match begin(state, &name) {
                    Err(error) => outcome = Err(error),
                    Ok(false) => {}
                    Ok(true) => {
                        let sender = sender.clone();
                        scope.spawn(move || {
                            let result = work(&name);
                            // The receiver outlives all threads of the scope.
                            let _ = sender.send((name, result));
                        });
                        running += 1;
                    }
                }
            }
            if running == 0 {
                return outcome;
            }
            let (name, result) = results.recv().context("a thread ended without a result")?;
            running -= 1;
            outcome = outcome.and(done(state, &name, result));
        }
    })
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};

    use super::*;

    fn names(count: usize) -> Vec<String> {
        (0..count).map(|index| index.to_string()).collect()
    }

    #[test]
    fn every_name_is_done_once_and_never_more_than_the_bound_at_once() {
        let running = AtomicUsize::new(0);
        let most = AtomicUsize::new(0);
        let mut done = Vec::new();
        let work = |name: &str| {
            most.fetch_max(running.fetch_add(1, Ordering::SeqCst) + 1, Ordering::SeqCst);
            std::thread::yield_now();
            running.fetch_sub(1, Ordering::SeqCst);
            name.len()
        };
        let note = |done: &mut Vec<String>, name: &str, length: usize| {
            assert_eq!(length, name.len());
            done.push(name.to_owned());
            Ok(())
        };
        in_parallel(names(50), 3, &mut done, |_, _| Ok(true), work, note).unwrap();
        done.sort_by_key(|name| name.parse::<usize>().unwrap());
        assert_eq!(done, names(50));
        assert!(most.load(Ordering::SeqCst) <= 3);
    }

    #[test]
    fn after_an_error_nothing_begins_and_what_runs_is_waited_for() {
        let mut begun = 0;
        let begin = |begun: &mut usize, _: &str| {
            *begun += 1;
            Ok(true)
        };
        let fail = |_: &mut usize, _: &str, (): ()| anyhow::bail!("disk full");
        let outcome = in_parallel(names(50), 4, &mut begun, begin, |_| (), fail);
        assert_eq!(outcome.unwrap_err().to_string(), "disk full");
        assert_eq!(begun, 4);
    }

    #[test]
    fn work_that_may_not_begin_is_left_out() {
        let mut done = 0;
        let begin = |_: &mut usize, name: &str| Ok(name == "3");
        let count = |done: &mut usize, _: &str, (): ()| {
            *done += 1;
            Ok(())
        };
        in_parallel(names(9), 2, &mut done, begin, |_| (), count).unwrap();
        assert_eq!(done, 1);
    }
}
