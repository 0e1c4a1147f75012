//! The thread that owns the device. Orders of all runs are gathered into batches; all batches advance together,
//! slice by slice.

use std::fmt::Debug;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use mcvl_core::forecast::ForecastError;
use wgpu::CommandEncoder;

use super::super::{AdapterInfo, GpuError};
use super::device::Device;
use super::{ddqn, td3};

/// How long a slice of work should take: far below the two seconds after which drivers take a kernel for hung.
const SLICE: Duration = Duration::from_millis(50);
/// Updates of the first slice; later ones follow the clock.
const FIRST_SLICE: u32 = 4;
/// How long an idle device waits for the orders of other runs.
const GATHER: Duration = Duration::from_millis(1);
/// Bytes of one batch at most, where the device would take more.
const BATCH_BYTES: u64 = 2 << 30;

/// Networks that train side by side on the device.
pub trait Training: Debug {
    /// Updates of the longest job.
    fn updates(&self) -> u32;
    /// Updates that one dispatch may make, where the device has a limit on their loops.
    fn longest_slice(&self, limit: Option<u32>) -> u32;
    /// Commands for the updates `first..first + count` of every job.
    fn encode(&self, device: &Device, commands: &mut CommandEncoder, first: u32, count: u32);
    /// What a job brings back, or 1 + the update whose loss was no finite number; in the order of the jobs.
    ///
    /// # Errors
    /// If the device fails.
    fn results(&self, device: &Device) -> Result<Vec<Result<Vec<f32>, u32>>, GpuError>;
}

/// What is to be trained.
#[derive(Clone, Debug)]
pub enum Work {
    /// A DDQN learner.
    Ddqn(Arc<ddqn::Packed>),
    /// A TD3 learner.
    Td3(Arc<td3::Packed>),
}

impl Work {
    fn updates(&self) -> u32 {
        match self {
            Self::Ddqn(packed) => packed.updates(),
            Self::Td3(packed) => packed.updates(),
        }
    }

    /// Bytes of each large buffer.
    fn bytes(&self) -> [u64; 2] {
        match self {
            Self::Ddqn(packed) => packed.bytes(),
            Self::Td3(packed) => packed.bytes(),
        }
    }

    /// Turns of the loops of one invocation in the least that can be dispatched.
    fn loops(&self) -> u32 {
        match self {
            Self::Ddqn(packed) => packed.loops(),
            Self::Td3(packed) => packed.loops(),
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
    closing: bool,
    /// Why the device is of no further use.
    failure: Option<GpuError>,
}

/// Where runs hand in their orders. The thread ends with it.
#[derive(Debug)]
pub struct Desk {
    room: Arc<Room>,
    info: AdapterInfo,
    thread: Option<JoinHandle<()>>,
}

/// Nothing panics while holding one of these locks.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().expect("no thread panicked")
}

impl Desk {
    /// Starts the thread.
    pub fn open(device: Device) -> Arc<Self> {
        let room = Arc::new(Room::default());
        let info = device.info().clone();
        let own = room.clone();
        let thread = thread::spawn(move || Worker::new(device, own).work());
        Arc::new(Self { room, info, thread: Some(thread) })
    }

    /// The adapter.
    pub fn adapter(&self) -> &AdapterInfo {
        &self.info
    }

    /// Hands in orders that are to begin together.
    pub fn order(&self, work: Vec<Work>) -> Vec<Arc<Ticket>> {
        let mut state = lock(&self.room.state);
        let mut tickets = Vec::new();
        for work in work {
            let ticket = Arc::new(Ticket::new(work.updates()));
            tickets.push(ticket.clone());
            match &state.failure {
                Some(failure) => ticket.finish(Err(ForecastError::BackEnd(failure.to_string()))),
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

/// Jobs under way.
#[derive(Debug)]
struct Running {
    training: Box<dyn Training>,
    tickets: Vec<Arc<Ticket>>,
    done: u32,
}

impl Running {
    fn wanted(&self) -> bool {
        self.tickets.iter().any(|ticket| !ticket.cancelled.load(Ordering::Relaxed))
    }
}

/// The thread's own things.
#[derive(Debug)]
struct Worker {
    device: Device,
    room: Arc<Room>,
    ddqn: ddqn::Kernel,
    /// Built for the first job.
    td3: Option<td3::Kernel>,
    running: Vec<Running>,
    slice: u32,
}

impl Worker {
    fn new(device: Device, room: Arc<Room>) -> Self {
        let ddqn = ddqn::Kernel::new(&device);
        Self { device, room, ddqn, td3: None, running: Vec::new(), slice: FIRST_SLICE }
    }

    fn work(mut self) {
        while let Some(orders) = self.orders() {
            self.admit(orders);
            if let Err(failure) = self.advance() {
                self.fail(failure);
            }
            self.room.finished.notify_all();
        }
    }

    /// What came in; waits if there is nothing else to do. `None` at the end.
    fn orders(&self) -> Option<Vec<Order>> {
        let mut state = lock(&self.room.state);
        if self.running.is_empty() {
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

    /// Brings orders to the device, in as many batches as its memory takes.
    fn admit(&mut self, orders: Vec<Order>) {
        let largest = self.device.largest_buffer().min(BATCH_BYTES);
        let mut group: Vec<Order> = Vec::new();
        let mut sum = [0u64; 2];
        for order in orders {
            if let Some(error) = order.work.too_large(largest, self.device.loop_limit()) {
                order.ticket.finish(Err(ForecastError::BackEnd(error.to_string())));
                continue;
            }
            let bytes = order.work.bytes();
            if sum.iter().zip(bytes).any(|(sum, bytes)| sum + bytes > largest) {
                self.start(std::mem::take(&mut group));
                sum = [0; 2];
            }
            sum = [sum[0] + bytes[0], sum[1] + bytes[1]];
            group.push(order);
        }
        self.start(group);
    }

    fn start(&mut self, orders: Vec<Order>) {
        let (mut ddqn, mut td3) = ((Vec::new(), Vec::new()), (Vec::new(), Vec::new()));
        for Order { work, ticket } in orders {
            match work {
                Work::Ddqn(packed) => {
                    ddqn.0.push(packed);
                    ddqn.1.push(ticket);
                }
                Work::Td3(packed) => {
                    td3.0.push(packed);
                    td3.1.push(ticket);
                }
            }
        }
        if !ddqn.0.is_empty() {
            let training = Box::new(ddqn::Batch::new(&self.device, &self.ddqn, &ddqn.0));
            self.running.push(Running { training, tickets: ddqn.1, done: 0 });
        }
        if !td3.0.is_empty() {
            let kernel = self.td3.get_or_insert_with(|| td3::Kernel::new(&self.device));
            let training = Box::new(td3::Batch::new(&self.device, kernel, &td3.0));
            self.running.push(Running { training, tickets: td3.1, done: 0 });
        }
    }

    /// One slice of every batch, and the results of those that are done.
    fn advance(&mut self) -> Result<(), GpuError> {
        self.running.retain(Running::wanted);
        if self.running.is_empty() {
            return Ok(());
        }
        let start = Instant::now();
        let mut commands = self.device.commands("slice");
        for running in &mut self.running {
            let longest = running.training.longest_slice(self.device.loop_limit());
            let count = self.slice.min(longest).min(running.training.updates() - running.done);
            if count > 0 {
                running.training.encode(&self.device, &mut commands, running.done, count);
                running.done += count;
            }
        }
        self.device.run(commands)?;
        let share = SLICE.as_secs_f64() / start.elapsed().as_secs_f64().max(1e-6);
        self.slice = ((f64::from(self.slice) * share.clamp(0.25, 2.0)) as u32).max(1);
        let mut index = 0;
        while index < self.running.len() {
            let running = &self.running[index];
            for ticket in &running.tickets {
                ticket.done.store(running.done.min(ticket.total), Ordering::Relaxed);
            }
            if running.done < running.training.updates() {
                index += 1;
                continue;
            }
            let results = running.training.results(&self.device)?;
            let running = self.running.swap_remove(index);
            for (ticket, result) in running.tickets.iter().zip(results) {
                ticket.finish(result.map_err(|update| ForecastError::NotFinite { update }));
            }
        }
        Ok(())
    }

    /// The device is of no further use: whoever waits or comes is told.
    fn fail(&mut self, failure: GpuError) {
        let mut state = lock(&self.room.state);
        let waiting = self.running.drain(..).flat_map(|running| running.tickets);
        let orders = state.orders.drain(..).map(|order| order.ticket);
        for ticket in waiting.chain(orders.collect::<Vec<_>>()) {
            ticket.finish(Err(ForecastError::BackEnd(failure.to_string())));
        }
        state.failure.get_or_insert(failure);
    }
}
