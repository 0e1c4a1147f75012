//! What moves the arm of Reacher: the face that every simulator of it has, and its equations in closed form.
//!
//! Both links are driven by motors of 200 N m, damped by 1 N m s/rad, and carry an armature of 1 kg m², beside
//! which the links themselves hardly count. The elbow has a soft limit at ±3 rad. One step of the world is two
//! steps of 0.01 s by the classical Runge-Kutta method of fourth order.

use core::fmt::Debug;

use serde::{Deserialize, Serialize};

/// Length of the upper arm, shoulder to elbow, in metres.
pub const UPPER_ARM: f64 = 0.1;
/// Length of the forearm, elbow to fingertip, in metres.
pub const FOREARM: f64 = 0.11;
/// The elbow's angle is softly limited to this on both sides, in radians. Under full torque it was seen at 3.31.
pub const ELBOW_LIMIT: f64 = 3.0;

/// Situation of the arm and its target, in metres, radians and seconds; the shoulder is the origin.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Motion {
    /// Angles of shoulder and elbow: 0, 0 is the arm stretched towards +x. They are not wrapped.
    pub angles: [f64; 2],
    /// Their velocities. Full torque reaches more than 100 rad/s.
    pub velocities: [f64; 2],
    /// Where the fingertip is reported. Inside an episode this is the fingertip of the last Runge-Kutta stage,
    /// which lags behind that of `angles` by up to 1.2 cm, as in MuJoCo.
    pub tip: [f64; 2],
    /// Where the fingertip should be.
    pub target: [f64; 2],
}

impl Motion {
    /// A situation after a reset: the fingertip is where the angles put it.
    pub fn start(angles: [f64; 2], velocities: [f64; 2], target: [f64; 2]) -> Self {
        Self { angles, velocities, tip: elbow_and_tip(angles)[1], target }
    }
}

/// Positions of elbow and fingertip at given angles.
pub fn elbow_and_tip([shoulder, elbow]: [f64; 2]) -> [[f64; 2]; 2] {
    let (sin, cos) = libm::sincos(shoulder);
    let joint = [UPPER_ARM * cos, UPPER_ARM * sin];
    let (sin, cos) = libm::sincos(shoulder + elbow);
    [joint, [joint[0] + FOREARM * cos, joint[1] + FOREARM * sin]]
}

/// A simulator of the arm. Its state is plain data: `Clone` forks it, and a snapshot holds all of it.
pub trait Physics: Clone + Debug {
    /// Puts the arm into a situation, as after a reset, and forgets everything before it. `tip` of the start
    /// is not read: it follows from the angles.
    ///
    /// All numbers must be finite: what becomes of others is up to the simulator.
    fn begin(&mut self, start: &Motion);

    /// Moves the arm for 0.02 s under a constant command to shoulder and elbow, in [-1, 1].
    fn advance(&mut self, command: [f64; 2]);

    /// The situation now.
    fn motion(&self) -> Motion;
}

/// The arm as two differential equations: the same bits on every target, and no library.
///
/// It follows MuJoCo 3.17.0 to 1e-14 where the elbow's limit does not act and to 3e-7 where it does: there
/// MuJoCo's solver stops at its tolerance, and this is the exact solution.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ClosedForm(Motion);

impl Default for ClosedForm {
    /// Stretched towards +x and at rest, with MuJoCo's rest position of the target.
    fn default() -> Self {
        Self(Motion::start([0.0; 2], [0.0; 2], [0.1, -0.1]))
    }
}

/// Seconds of one simulator step.
const STEP: f64 = 0.01;
/// Simulator steps of one environment step.
const FRAMES: u32 = 2;
/// Torque of a motor at command 1, in N m.
const GEAR: f64 = 200.0;
/// A link's mass in kg, and its moment of inertia about its centre, across its axis, in kg m²: a capsule of
/// radius 1 cm and length 10 cm with density 1000.
const LINK: (f64, f64) = (0.03560471674068432, 3.9175660390264734e-5);
/// The same of the fingertip: a ball of radius 1 cm.
const TIP: (f64, f64) = (0.004188790204786391, 1.6755160819145567e-7);
/// Added to each joint's moment of inertia, in kg m².
const ARMATURE: f64 = 1.0;
/// Distance of a link's centre from the joint that moves it.
const CENTRE: f64 = 0.05;
/// Inverse inertia that MuJoCo takes for the elbow's limit, from the rest pose.
const ELBOW_INVERSE_INERTIA: f64 = 0.9998211549602818;

/// Mass moments about the elbow: of first and of second order.
const FIRST: f64 = LINK.0 * CENTRE + TIP.0 * FOREARM;
const SECOND: f64 = LINK.0 * CENTRE * CENTRE + LINK.1 + TIP.0 * FOREARM * FOREARM + TIP.1;
/// The inertia matrix at an elbow angle with cosine c is
/// `[[M11 + 2 * COUPLING * c, M12 + COUPLING * c], [M12 + COUPLING * c, M22]]`.
const COUPLING: f64 = UPPER_ARM * FIRST;
const M12: f64 = SECOND;
const M22: f64 = ARMATURE + SECOND;
const M11: f64 = ARMATURE + LINK.0 * CENTRE * CENTRE + LINK.1 + (LINK.0 + TIP.0) * UPPER_ARM * UPPER_ARM + SECOND;

/// Angular accelerations under a command.
fn acceleration(angles: [f64; 2], velocities: [f64; 2], command: [f64; 2]) -> [f64; 2] {
    let (sin, cos) = libm::sincos(angles[1]);
    let [v0, v1] = velocities;
    let (m11, m12) = (M11 + 2.0 * COUPLING * cos, M12 + COUPLING * cos);
    let h = COUPLING * sin;
    let t0 = GEAR * command[0] - v0 + h * (2.0 * v0 * v1 + v1 * v1);
    let t1 = GEAR * command[1] - v1 - h * v0 * v0;
    let determinant = m11 * M22 - m12 * m12;
    // The inverse of the inertia matrix, without its first entry.
    let (i12, i22) = (-m12 / determinant, m11 / determinant);
    let mut a0 = M22 / determinant * t0 + i12 * t1;
    let mut a1 = i12 * t0 + i22 * t1;
    let gap = ELBOW_LIMIT - angles[1].abs();
    if gap < 0.0 {
        let direction = if angles[1] > 0.0 { -1.0 } else { 1.0 };
        let force = direction * limit_force(gap, direction * v1, direction * a1, i22);
        a0 += i12 * force;
        a1 += i22 * force;
    }
    [a0, a1]
}

/// Torque of the elbow's limit, away from it: MuJoCo's soft constraint with its default parameters (solref
/// 0.02 1, solimp 0.9 0.95 0.001 0.5 2), solved exactly.
///
/// `gap` is negative beyond the limit; velocity and acceleration without the limit count away from it.
fn limit_force(gap: f64, velocity: f64, acceleration: f64, inverse_inertia: f64) -> f64 {
    let x = -gap / 0.001;
    let y = match x {
        x if x >= 1.0 => 1.0,
        x if x <= 0.5 => 2.0 * x * x,
        x => 1.0 - 2.0 * (1.0 - x) * (1.0 - x),
    };
    let impedance = 0.9 + 0.05 * y;
    let time = 0.95 * 0.02;
    let reference = -2.0 / time * velocity - impedance * gap / (time * time);
    let regularisation = (1.0 - impedance) / impedance * ELBOW_INVERSE_INERTIA;
    ((reference - acceleration) / (regularisation + inverse_inertia)).max(0.0)
}

fn ahead(from: [f64; 2], time: f64, rate: [f64; 2]) -> [f64; 2] {
    [from[0] + time * rate[0], from[1] + time * rate[1]]
}

/// Weighted mean of the rates of the four stages.
fn mean([a, b, c, d]: [[f64; 2]; 4]) -> [f64; 2] {
    core::array::from_fn(|i| (a[i] + 2.0 * b[i] + 2.0 * c[i] + d[i]) / 6.0)
}

impl Physics for ClosedForm {
    fn begin(&mut self, start: &Motion) {
        self.0 = Motion::start(start.angles, start.velocities, start.target);
    }

    fn advance(&mut self, command: [f64; 2]) {
        let mut last = self.0.angles;
        for _ in 0..FRAMES {
            let (q1, v1) = (self.0.angles, self.0.velocities);
            let a1 = acceleration(q1, v1, command);
            let (q2, v2) = (ahead(q1, STEP / 2.0, v1), ahead(v1, STEP / 2.0, a1));
            let a2 = acceleration(q2, v2, command);
            let (q3, v3) = (ahead(q1, STEP / 2.0, v2), ahead(v1, STEP / 2.0, a2));
            let a3 = acceleration(q3, v3, command);
            let (q4, v4) = (ahead(q1, STEP, v3), ahead(v1, STEP, a3));
            let a4 = acceleration(q4, v4, command);
            self.0.angles = ahead(q1, STEP, mean([v1, v2, v3, v4]));
            self.0.velocities = ahead(v1, STEP, mean([a1, a2, a3, a4]));
            last = q4;
        }
        // MuJoCo's positions after a step are those of the last stage, and reward and observation use them.
        self.0.tip = elbow_and_tip(last)[1];
    }

    fn motion(&self) -> Motion {
        self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn inertia_of_the_fact_sheet() {
        let cos = libm::cos(0.0901);
        let (m11, m12) = (M11 + 2.0 * COUPLING * cos, M12 + COUPLING * cos);
        for (value, expected) in [(m11, 1.00115154), (m12, 4.02231e-4), (M22, 1.00017904)] {
            assert!((value - expected).abs() < 5e-9, "{value} instead of {expected}");
        }
        // The inertias that MuJoCo reports at rest, and the inverse that it keeps for the limit.
        assert!((M11 + 2.0 * COUPLING - 1.0011533624389368).abs() < 1e-15, "{}", M11 + 2.0 * COUPLING);
        assert!((M22 - 1.000179039365328).abs() < 1e-15, "{M22}");
        let (m11, m12) = (M11 + 2.0 * COUPLING, M12 + COUPLING);
        assert!((m11 / (m11 * M22 - m12 * m12) - ELBOW_INVERSE_INERTIA).abs() < 1e-15);
    }

    #[test]
    fn full_torque_gives_4_rad_per_second_and_step() {
        let mut arm = ClosedForm::default();
        arm.advance([1.0, 0.0]);
        let [shoulder, elbow] = arm.motion().velocities;
        assert!((3.9..4.0).contains(&shoulder) && elbow.abs() < 0.01, "{shoulder} {elbow}");
    }

    #[test]
    fn an_arm_without_command_comes_to_rest() {
        let mut arm = ClosedForm::default();
        arm.begin(&Motion::start([0.3, -1.0], [5.0, 3.0], [0.0, 0.1]));
        (0..2000).for_each(|_| arm.advance([0.0; 2]));
        let motion = arm.motion();
        assert!(motion.velocities.iter().all(|v| v.abs() < 1e-9), "{motion:?}");
        // Damping and armature are both 1: v rad/s are stopped after about v rad.
        assert!((motion.angles[0] - 5.3).abs() < 0.05 && (motion.angles[1] - 2.0).abs() < 0.05, "{motion:?}");
        assert_eq!(motion.target, [0.0, 0.1]);
    }

    #[test]
    fn the_elbow_gives_way_and_is_pushed_back() {
        for side in [1.0, -1.0] {
            let mut arm = ClosedForm::default();
            let mut angles = alloc::vec::Vec::new();
            for _ in 0..200 {
                arm.advance([0.0, side]);
                angles.push(side * arm.motion().angles[1]);
            }
            let far = angles.iter().copied().fold(0.0, f64::max);
            assert!(far > ELBOW_LIMIT && far < 4.0, "{far}");
            let last = arm.motion();
            assert!((side * last.angles[1] - ELBOW_LIMIT).abs() < 0.2 && last.velocities[1].abs() < 1e-3, "{last:?}");
        }
    }

    #[test]
    fn the_reported_fingertip_lags() {
        let mut arm = ClosedForm::default();
        for _ in 0..10 {
            arm.advance([1.0, -1.0]);
        }
        let motion = arm.motion();
        let real = elbow_and_tip(motion.angles)[1];
        let lag = (real[0] - motion.tip[0]).abs() + (real[1] - motion.tip[1]).abs();
        assert!(lag > 1e-9 && lag < 1.2e-2, "{lag}");
        arm.begin(&motion);
        assert_eq!(arm.motion().tip, real);
    }
}
