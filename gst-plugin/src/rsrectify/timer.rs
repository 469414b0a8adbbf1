// SPDX-License-Identifier: MIT OR Apache-2.0

//! Calls a function at a time of the pipeline's clock.

use gst::prelude::*;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};

/// The longest single wait. GStreamer's clock never comes back from a wait until the end of time, which is what
/// a wrong timestamp may ask for, not even when the wait is called off.
const LONGEST: gst::ClockTime = gst::ClockTime::from_seconds(3600);

/// A thread that waits for one time after another.
#[derive(Debug)]
pub struct Timer {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

#[derive(Debug, Default)]
struct Shared {
    orders: Mutex<Orders>,
    changed: Condvar,
}

#[derive(Debug, Default)]
struct Orders {
    /// The time to wait for next.
    next: Option<(gst::Clock, gst::ClockTime)>,
    /// The wait at present.
    waiting: Option<gst::SingleShotClockId>,
    stopped: bool,
}

impl Shared {
    fn orders(&self) -> MutexGuard<'_, Orders> {
        self.orders.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Waits for an order; `None` at the end.
    fn next(&self) -> Option<gst::SingleShotClockId> {
        let mut orders = self.orders();
        loop {
            if orders.stopped {
                return None;
            }
            if let Some((clock, time)) = orders.next.take() {
                let soon = clock.time().saturating_add(LONGEST);
                let id = clock.new_single_shot_id(time.min(soon));
                orders.waiting = Some(id.clone());
                return Some(id);
            }
            orders = self.changed.wait(orders).unwrap_or_else(PoisonError::into_inner);
        }
    }
}

impl Orders {
    fn interrupt(&mut self) {
        if let Some(waiting) = self.waiting.take() {
            waiting.unschedule();
        }
    }
}

impl Timer {
    /// A timer that calls `act` each time it has waited to the end, or for an hour.
    pub fn new(act: impl Fn() + Send + 'static) -> std::io::Result<Self> {
        let shared = Arc::<Shared>::default();
        let of_thread = shared.clone();
        let run = move || {
            while let Some(id) = of_thread.next() {
                let (result, _) = id.wait();
                of_thread.orders().waiting = None;
                // A time that has passed already is due, too.
                if matches!(result, Ok(_) | Err(gst::ClockError::Early)) {
                    act();
                }
            }
        };
        let thread = thread::Builder::new().name("rsrectify-timer".into()).spawn(run)?;
        Ok(Self { shared, thread: Some(thread) })
    }

    /// Waits for `time` of `clock` from now on, instead of what was asked for before; for nothing if `None`.
    pub fn set(&self, next: Option<(gst::Clock, gst::ClockTime)>) {
        let mut orders = self.shared.orders();
        orders.next = next;
        orders.interrupt();
        self.shared.changed.notify_one();
    }
}

impl Drop for Timer {
    /// Waits for the thread to end, unless it is the one that drops the timer.
    fn drop(&mut self) {
        {
            let mut orders = self.shared.orders();
            orders.stopped = true;
            orders.interrupt();
        }
        self.shared.changed.notify_one();
        if let Some(thread) = self.thread.take().filter(|own| own.thread().id() != thread::current().id()) {
            // A panic in it has been reported where it happened.
            let _ = thread.join();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::mpsc;
    use std::time::Duration;

    const PATIENCE: Duration = Duration::from_secs(30);

    #[test]
    fn it_acts_at_the_time_and_only_then() {
        gst::init().unwrap();
        let clock = gst::SystemClock::obtain();
        let (acts, acted) = mpsc::channel();
        let timer = Timer::new(move || acts.send(()).unwrap()).unwrap();
        timer.set(Some((clock.clone(), clock.time() + gst::ClockTime::from_seconds(100))));
        timer.set(Some((clock.clone(), clock.time())));
        acted.recv_timeout(PATIENCE).unwrap();
        timer.set(Some((clock.clone(), clock.time() + gst::ClockTime::from_seconds(100))));
        drop(timer);
        assert!(acted.try_recv().is_err());
    }

    #[test]
    fn a_wait_for_any_time_can_be_called_off() {
        gst::init().unwrap();
        let (done, ended) = mpsc::channel();
        thread::spawn(move || {
            let clock = gst::SystemClock::obtain();
            let timer = Timer::new(|| ()).unwrap();
            for time in [u64::MAX - 1, u64::MAX / 2, i64::MAX as u64 + 1, 1 << 62] {
                timer.set(Some((clock.clone(), gst::ClockTime::from_nseconds(time))));
                thread::sleep(Duration::from_millis(20));
            }
            drop(timer);
            done.send(()).unwrap();
        });
        ended.recv_timeout(PATIENCE).expect("the timer is stopped");
    }
}
