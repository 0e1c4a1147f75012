//! The thread that owns the device. Orders of all runs are trained there together, slice by slice: DDQN learners in
//! one dispatch whenever they came in, TD3 learners in batches of those that came in together.

use std::collections::VecDeque;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use mcvl_core::forecast::ForecastError;

use super::super::{AdapterInfo, GpuError};
use super::arithmetic::Arithmetic;
use super::device::Device;
use super::pool::{self, Check, Pool};
use super::transfer::Outcome;
use super::{ddqn, td3};

/// How long a slice of work should take: far below the two seconds after which drivers take a kernel for hung, and so
/// short that those who come do not wait for long.
const SLICE: Duration = Duration::from_millis(25);
/// Updates of the first slice; later ones follow the clock.
const FIRST_SLICE: u32 = 4;
/// How long an idle device waits for the orders of other runs.
const GATHER: Duration = Duration::from_millis(1);

/// What is to be trained.
#[derive(Clone, Debug)]
pub enum Work {
    /// A DDQN learner.
    Ddqn(Arc<ddqn::Packed>),
    /// A TD3 learner.
    Td3(Arc<td3::Packed>),
    /// What makes the thread panic, as a driver can.
    #[cfg(test)]
    Panic,
}

impl Work {
    fn updates(&self) -> u32 {
        match self {
            Self::Ddqn(packed) => packed.updates(),
            Self::Td3(packed) => packed.updates(),
            #[cfg(test)]
            Self::Panic => 1,
        }
    }

    /// Bytes of each large buffer.
    fn bytes(&self) -> [u64; 2] {
        match self {
            Self::Ddqn(packed) => packed.bytes(),
            Self::Td3(packed) => packed.bytes(),
            #[cfg(test)]
            Self::Panic => [0; 2],
        }
    }

    /// Turns of the loops of one invocation in the least that can be dispatched.
    fn loops(&self) -> u32 {
        match self {
            Self::Ddqn(packed) => packed.loops(),
            Self::Td3(packed) => packed.loops(),
            #[cfg(test)]
            Self::Panic => 0,
        }
    }

    /// Whether one job alone is more than the device can do.
    fn too_large(&self, largest: u64, loops: Option<u32>) -> Option<GpuError> {
        let needed = self.bytes().into_iter().max().unwrap_or(0);
        if needed > largest {
            let (needed, largest) = (needed >> 20, largest >> 20);
            return Some(GpuError::TooLarge(format!(
                "it needs {needed} MiB in one buffer, and there may be {largest}"
            )));
        }
        let limit = loops.filter(|limit| self.loops() > *limit)?;
        Some(GpuError::TooLarge(format!("an update has {} turns of loops, and there may be {limit}", self.loops())))
    }
}

/// How an order stands.
#[derive(Debug)]
pub struct Ticket {
    total: u32,
    done: AtomicU32,
    cancelled: AtomicBool,
    result: Mutex<Option<Result<Vec<f32>, ForecastError>>>,
}

impl Ticket {
    fn new(total: u32) -> Self {
        Self { total, done: AtomicU32::new(0), cancelled: AtomicBool::new(false), result: Mutex::new(None) }
    }

    /// Whether there is a result.
    pub fn is_ready(&self) -> bool {
        lock(&self.result).is_some()
    }

    /// The result, once.
    pub fn take(&self) -> Option<Result<Vec<f32>, ForecastError>> {
        lock(&self.result).take()
    }

    /// Part that is done, 0 to 1.
    pub fn progress(&self) -> f32 {
        self.done.load(Ordering::Relaxed) as f32 / self.total.max(1) as f32
    }

    /// Nobody waits for it any more.
    pub fn cancel(&self) {
        self.cancelled.store(true, Ordering::Relaxed);
    }

    fn finish(&self, result: Result<Vec<f32>, ForecastError>) {
        *lock(&self.result) = Some(result);
    }
}

/// What a run waits for.
#[derive(Debug, Default)]
pub struct Waiting(Mutex<Vec<Arc<Ticket>>>);

impl Waiting {
    /// Whether there is nothing to do but wait.
    pub fn now(&self) -> bool {
        lock(&self.0).iter().any(|ticket| !ticket.is_ready())
    }

    /// The run waits for these.
    pub fn set(&self, tickets: Vec<Arc<Ticket>>) {
        *lock(&self.0) = tickets;
    }
}

#[derive(Debug)]
struct Order {
    work: Work,
    ticket: Arc<Ticket>,
}

/// What the thread and the runs share.
#[derive(Debug, Default)]
struct Room {
    state: Mutex<State>,
    /// There is something for the thread to do.
    ordered: Condvar,
    /// Something was finished.
    finished: Condvar,
}

#[derive(Debug, Default)]
struct State {
    orders: Vec<Order>,
    /// Every ticket that may still be without its result, wherever its job is by now.
    open: Vec<Arc<Ticket>>,
    closing: bool,
    /// Why the device is of no further use.
    failure: Option<GpuError>,
}

/// Where runs hand in their orders. The thread ends with it.
#[derive(Debug)]
pub struct Desk {
    room: Arc<Room>,
    info: AdapterInfo,
    arithmetic: Arithmetic,
    thread: Option<JoinHandle<()>>,
}

/// What runs are told.
fn failed(error: &GpuError) -> ForecastError {
    ForecastError::BackEnd(error.to_string())
}

/// Nothing panics while holding one of these locks.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().expect("no thread panicked")
}

impl Desk {
    /// Starts the thread.
    pub fn open(device: Device) -> Arc<Self> {
        let room = Arc::new(Room::default());
        let (info, arithmetic) = (device.info().clone(), device.arithmetic());
        let own = room.clone();
        let thread = thread::spawn(move || Worker::new(device, own).work());
        Arc::new(Self { room, info, arithmetic, thread: Some(thread) })
    }

    /// The adapter.
    pub fn adapter(&self) -> &AdapterInfo {
        &self.info
    }

    /// How the kernels compute.
    pub fn arithmetic(&self) -> Arithmetic {
        self.arithmetic
    }

    /// Hands in orders that are to begin together.
    pub fn order(&self, work: Vec<Work>) -> Vec<Arc<Ticket>> {
        let mut state = lock(&self.room.state);
        let mut tickets = Vec::new();
        state.open.retain(|ticket| !ticket.is_ready());
        for work in work {
            let ticket = Arc::new(Ticket::new(work.updates()));
            tickets.push(ticket.clone());
            state.open.push(ticket.clone());
            match &state.failure {
                Some(failure) => ticket.finish(Err(failed(failure))),
                None => state.orders.push(Order { work, ticket }),
            }
        }
        self.room.ordered.notify_one();
        tickets
    }

    /// Waits until something was finished, or for this long.
    pub fn wait(&self, time: Duration) {
        let state = lock(&self.room.state);
        drop(self.room.finished.wait_timeout(state, time).expect("no thread panicked"));
    }
}

impl Drop for Desk {
    fn drop(&mut self) {
        lock(&self.room.state).closing = true;
        self.room.ordered.notify_one();
        if let Some(thread) = self.thread.take() {
            // A panic there was printed there.
            drop(thread.join());
        }
    }
}

/// What trains together, from its first update to its last.
#[derive(Debug)]
enum Training {
    Check(Check),
    Batch(td3::Batch),
}

impl Training {
    /// Updates of the longest job.
    fn updates(&self) -> u32 {
        match self {
            Self::Check(check) => check.updates(),
            Self::Batch(batch) => batch.updates(),
        }
    }

    /// Updates that one dispatch may make, where the device has a limit on their loops.
    fn longest_slice(&self, limit: Option<u32>) -> u32 {
        match self {
            Self::Check(check) => check.longest_slice(limit),
            // An update is many dispatches, so the loops of one do not grow with the slice.
            Self::Batch(_) => u32::MAX,
        }
    }
}

/// Jobs under way.
#[derive(Debug)]
struct Running {
    training: Training,
    tickets: Vec<Arc<Ticket>>,
    done: u32,
    /// Bytes of its largest job.
    size: u64,
    /// Updates that it may make in the next slice.
    slice: u32,
}

impl Running {
    /// What is larger than all that was timed, up to `familiar` bytes, has to show first how long its updates take.
    fn new(training: Training, tickets: Vec<Arc<Ticket>>, size: u64, familiar: u64) -> Self {
        let slice = if size > familiar { FIRST_SLICE } else { u32::MAX };
        Self { training, tickets, done: 0, size, slice }
    }

    fn is_done(&self) -> bool {
        self.done >= self.training.updates()
    }

    fn finish(&self, results: Vec<Outcome>) {
        for (ticket, result) in self.tickets.iter().zip(results) {
            ticket.finish(result.map_err(|update| ForecastError::NotFinite { update }));
        }
    }
}

/// Whether somebody waits for one of these.
fn is_wanted(tickets: &[Arc<Ticket>]) -> bool {
    tickets.iter().any(|ticket| !ticket.cancelled.load(Ordering::Relaxed))
}

/// The learners of one check, before they are on the device.
#[derive(Debug, Default)]
struct Arrival {
    jobs: Vec<Arc<ddqn::Packed>>,
    tickets: Vec<Arc<Ticket>>,
}

/// The thread's own things.
#[derive(Debug)]
struct Worker {
    device: Device,
    room: Arc<Room>,
    ddqn: Pool,
    /// Built for the first job.
    td3: Option<td3::Kernel>,
    /// Checks for which there is no room yet.
    arrived: VecDeque<Arrival>,
    running: Vec<Running>,
    slice: u32,
    /// Bytes of the largest job whose updates were timed.
    familiar: u64,
}

impl Worker {
    fn new(device: Device, room: Arc<Room>) -> Self {
        let (ddqn, arrived) = (Pool::new(&device), VecDeque::new());
        Self { device, room, ddqn, td3: None, arrived, running: Vec::new(), slice: FIRST_SLICE, familiar: 0 }
    }

    fn work(mut self) {
        while let Some(orders) = self.orders() {
            // A driver that fails can end in a panic within wgpu; whoever waits is told of that as of any other failure.
            let turn = catch_unwind(AssertUnwindSafe(|| {
                self.take(orders);
                self.admit().and_then(|()| self.advance())
            }));
            match turn {
                Ok(Ok(())) => {}
                Ok(Err(failure)) => self.fail(failure),
                Err(_) => self.fail(GpuError::Lost("its thread panicked, as printed above".to_owned())),
            }
            self.room.finished.notify_all();
        }
    }

    /// What came in; waits if there is nothing else to do. `None` at the end.
    fn orders(&self) -> Option<Vec<Order>> {
        let mut state = lock(&self.room.state);
        if self.running.is_empty() && self.arrived.is_empty() {
            state = self
                .room
                .ordered
                .wait_while(state, |state| state.orders.is_empty() && !state.closing)
                .expect("no thread panicked");
            if !state.closing {
                drop(state);
                thread::sleep(GATHER);
                state = lock(&self.room.state);
            }
        }
        (!state.closing).then(|| std::mem::take(&mut state.orders))
    }

    /// Sorts orders: DDQN learners by checks, TD3 learners into as many batches as the memory of the device takes.
    fn take(&mut self, orders: Vec<Order>) {
        let largest = self.device.largest_buffer().min(pool::LARGEST);
        let (mut checks, mut batch): (Vec<Arrival>, _) = (Vec::new(), (Vec::new(), Vec::new()));
        let mut sum = [0u64; 2];
        for Order { work, ticket } in orders {
            if let Some(error) = work.too_large(largest, self.device.loop_limit()) {
                ticket.finish(Err(failed(&error)));
                continue;
            }
            let bytes = work.bytes();
            match work {
                Work::Ddqn(packed) => {
                    let fits = |check: &&mut Arrival| {
                        let together =
                            check.jobs.iter().map(|job| job.bytes()).fold(bytes, |a, b| [a[0] + b[0], a[1] + b[1]]);
                        check.jobs[0].is_of_the_check_of(&packed)
                            && check.jobs.len() < pool::SLOTS as usize
                            && together.iter().all(|bytes| *bytes <= largest)
                    };
                    match checks.last_mut().filter(fits) {
                        Some(check) => {
                            check.jobs.push(packed);
                            check.tickets.push(ticket);
                        }
                        None => checks.push(Arrival { jobs: vec![packed], tickets: vec![ticket] }),
                    }
                }
                #[cfg(test)]
                Work::Panic => panic!("a driver that fails"),
                Work::Td3(packed) => {
                    if sum.iter().zip(bytes).any(|(sum, bytes)| sum + bytes > largest) {
                        self.start(std::mem::take(&mut batch));
                        sum = [0; 2];
                    }
                    sum = [sum[0] + bytes[0], sum[1] + bytes[1]];
                    batch.0.push(packed);
                    batch.1.push(ticket);
                }
            }
        }
        self.start(batch);
        self.arrived.extend(checks);
    }

    fn start(&mut self, (packed, tickets): (Vec<Arc<td3::Packed>>, Vec<Arc<Ticket>>)) {
        if !packed.is_empty() {
            let kernel = self.td3.get_or_insert_with(|| td3::Kernel::new(&self.device));
            let training = Training::Batch(td3::Batch::new(&self.device, kernel, &packed));
            let size = packed.iter().map(|job| job.bytes()[0]).max().unwrap_or(0);
            self.running.push(Running::new(training, tickets, size, self.familiar));
        }
    }

    /// Brings waiting checks to the device as long as there is room, after those that nobody wants any more have left.
    fn admit(&mut self) -> Result<(), GpuError> {
        let mut index = 0;
        while index < self.running.len() {
            if is_wanted(&self.running[index].tickets) {
                index += 1;
            } else if let Training::Check(check) = self.running.swap_remove(index).training {
                self.ddqn.release(check);
            }
        }
        self.arrived.retain(|arrival| is_wanted(&arrival.tickets));
        while let Some(arrival) = self.arrived.front() {
            let Some(check) = self.ddqn.admit(&self.device, &arrival.jobs)? else {
                if self.ddqn.is_empty() {
                    // What is too large was told when it came; nobody may wait for ever all the same.
                    let error = GpuError::TooLarge("there is no room for it on an empty device".to_owned());
                    arrival.tickets.iter().for_each(|ticket| ticket.finish(Err(failed(&error))));
                    self.arrived.pop_front();
                    continue;
                }
                break;
            };
            let Arrival { jobs, tickets } = self.arrived.pop_front().unwrap_or_default();
            let size = jobs.iter().map(|job| job.bytes()[0]).max().unwrap_or(0);
            self.running.push(Running::new(Training::Check(check), tickets, size, self.familiar));
        }
        Ok(())
    }

    /// One slice of everything, and the results of what is done.
    fn advance(&mut self) -> Result<(), GpuError> {
        if self.running.is_empty() {
            return Ok(());
        }
        let start = Instant::now();
        let (mut commands, mut most) = (self.device.commands("slice"), 0);
        for running in &mut self.running {
            let longest = running.training.longest_slice(self.device.loop_limit());
            let count = self.slice.min(running.slice).min(longest).min(running.training.updates() - running.done);
            running.slice = running.slice.saturating_mul(2);
            if count > 0 {
                match &running.training {
                    Training::Check(check) => self.ddqn.plan(check, running.done, count),
                    Training::Batch(batch) => batch.encode(&mut commands, running.done, count),
                }
                running.done += count;
                most = most.max(count);
            }
        }
        self.ddqn.encode(&self.device, &mut commands);
        self.device.run(commands)?;
        if most > 0 {
            // From what was done, which can be less than a slice and then says nothing against a longer one.
            let share = SLICE.as_secs_f64() / start.elapsed().as_secs_f64().max(1e-6);
            let next = ((f64::from(most) * share.clamp(0.25, 2.0)) as u32).max(1);
            self.slice = if share < 1.0 { next } else { next.max(self.slice) };
            self.familiar = self.running.iter().map(|running| running.size).fold(self.familiar, u64::max);
        }
        for running in &self.running {
            for ticket in &running.tickets {
                ticket.done.store(running.done.min(ticket.total), Ordering::Relaxed);
            }
        }
        self.deliver()
    }

    /// Hands out the results of what is done.
    fn deliver(&mut self) -> Result<(), GpuError> {
        let (done, running): (Vec<_>, Vec<_>) = self.running.drain(..).partition(Running::is_done);
        self.running = running;
        let results = match self.results(&done) {
            Ok(results) => results,
            Err(failure) => {
                // They are told with the others.
                self.running.extend(done);
                return Err(failure);
            }
        };
        for (running, results) in done.into_iter().zip(results) {
            running.finish(results);
            if let Training::Check(check) = running.training {
                self.ddqn.release(check);
            }
        }
        Ok(())
    }

    /// What came out, in the order of what is done; of all checks at once.
    fn results(&self, done: &[Running]) -> Result<Vec<Vec<Outcome>>, GpuError> {
        let checks: Vec<&Check> = done
            .iter()
            .filter_map(|running| match &running.training {
                Training::Check(check) => Some(check),
                Training::Batch(_) => None,
            })
            .collect();
        let mut of_checks = self.ddqn.results(&self.device, &checks)?.into_iter();
        done.iter()
            .map(|running| match &running.training {
                Training::Check(_) => Ok(of_checks.by_ref().take(running.tickets.len()).collect()),
                Training::Batch(batch) => batch.results(&self.device),
            })
            .collect()
    }

    /// The device is of no further use: whoever waits or comes is told.
    fn fail(&mut self, failure: GpuError) {
        let mut state = lock(&self.room.state);
        self.running.clear();
        self.arrived.clear();
        state.orders.clear();
        for ticket in state.open.drain(..).filter(|ticket| !ticket.is_ready()) {
            ticket.finish(Err(failed(&failure)));
        }
        state.failure.get_or_insert(failure);
    }
}
