using System;
using UnityEngine;
using UnityEngine.Events;

namespace Hapticnet.Unity
{
    /// <summary>Lets this object touch what a hapticnet slave has, and be pushed by it.</summary>
    /// <remarks>The object's position relative to <see cref="frame"/> goes to the slave a thousand times a second, from
    /// a thread of its own; the force that comes back acts on <see cref="body"/>, and is told by <see cref="onForce"/>.
    /// In the frame, the scene's first axis, which leads into what is touched, points forward, its second right and
    /// its third up.</remarks>
    [AddComponentMenu("Hapticnet/Haptic Master")]
    public sealed class HapticMaster : MonoBehaviour, IHand
    {
        /// <summary>The slave's host.</summary>
        [Header("Slave")]
        public string host = "127.0.0.1";

        /// <summary>The slave's UDP port.</summary>
        public int port = 47800;

        /// <summary>The slave's public key, for a sealed session; empty for an open one.</summary>
        public string slaveKey = "";

        /// <summary>The own key file; empty: that of 'hapticnet key new'. An open session needs none.</summary>
        public string keyFile = "";

        /// <summary>How forces are compressed.</summary>
        [Header("Request")]
        public string codec = "deadband";

        /// <summary>The name of this master in the slave's report.</summary>
        public string masterName = "Unity";

        /// <summary>Number of axes; as many as the slave's scene has.</summary>
        [Range(1, 3)]
        public int axes = 1;

        /// <summary>Where the scene is, and how large: a unit of this frame is a metre. None: the world.</summary>
        [Header("Hand")]
        public Transform frame;

        /// <summary>What the force acts on; none: only the event tells it.</summary>
        public Rigidbody body;

        /// <summary>No greater force is applied [N].</summary>
        public float largestForceN = 5.0f;

        /// <summary>Tells the force [N] in world coordinates, in each fixed update.</summary>
        [Serializable]
        public sealed class ForceEvent : UnityEvent<Vector3>
        {
        }

        /// <summary>Called in each fixed update with the force [N] on the hand, in world coordinates.</summary>
        public ForceEvent onForce = new ForceEvent();

        private readonly object _lock = new object();
        private readonly double[] _fromM = new double[3], _toM = new double[3], _forceN = new double[3];
        private readonly double[] _placeM = new double[3];
        private long _fromUs;
        private double _glideUs = 1.0;
        private MasterLink _link;
        private SessionState _told;

        /// <summary>The link; null while this component is disabled.</summary>
        public MasterLink Link
        {
            get { return _link; }
        }

        /// <summary>The force [N] on the hand now, in world coordinates.</summary>
        public Vector3 Force { get; private set; }

        void IHand.Read(double[] positionM)
        {
            // Fixed updates are rarer than ticks. The hand glides from the last but one to the last, one update late:
            // in steps, it would have a speed that a viscous scene answers with blows.
            lock (_lock)
            {
                double share = Math.Min((Node.NowUs - _fromUs) / _glideUs, 1.0);
                for (int i = 0; i < positionM.Length; i++)
                    positionM[i] = _fromM[i] + share * (_toM[i] - _fromM[i]);
            }
        }

        void IHand.Apply(double[] forceN)
        {
            lock (_lock)
                Array.Copy(forceN, _forceN, forceN.Length);
        }

        private void OnEnable()
        {
            Place();
            Array.Copy(_toM, _fromM, _toM.Length);
            Array.Clear(_forceN, 0, _forceN.Length);
            Force = Vector3.zero;
            _told = SessionState.Connecting;
            try
            {
                var request = new Request { Codec = codec, Name = masterName, Axes = axes };
                PrivateKey key = slaveKey.Length > 0 ? PrivateKey.Load(keyFile.Length > 0 ? keyFile : null) : null;
                byte[] slave = key == null ? null : PrivateKey.Parse(slaveKey);
                using (key)
                    _link = new MasterLink(host, port, request, this, key, slave);
            }
            catch (HapticException error)
            {
                Debug.LogError("HapticMaster: " + error.Message, this);
                enabled = false;
            }
        }

        private void FixedUpdate()
        {
            if (_link == null)
                return;
            Place();
            Push();
            if (_link.Failure != null || _link.State != _told)
                Tell();
        }

        private void OnDisable()
        {
            if (_link != null)
                _link.Dispose();
            _link = null;
            Force = Vector3.zero;
        }

        /// <summary>Let the hand glide to where the object is now.</summary>
        private void Place()
        {
            Vector3 at = frame == null ? transform.position : frame.InverseTransformPoint(transform.position);
            lock (_lock)
            {
                ((IHand)this).Read(_placeM);
                Array.Copy(_placeM, _fromM, _fromM.Length);
                _toM[0] = at.z;
                _toM[1] = at.x;
                _toM[2] = at.y;
                _fromUs = Node.NowUs;
                _glideUs = Math.Max(Time.fixedDeltaTime * 1e6, 1.0);
            }
        }

        private void Push()
        {
            Vector3 outward;
            lock (_lock) // a positive force pushes against the direction of its axis
                outward = new Vector3(-(float)_forceN[1], -(float)_forceN[2], -(float)_forceN[0]);
            Vector3 force = frame == null ? outward : frame.TransformDirection(outward);
            Force = Vector3.ClampMagnitude(force, largestForceN);
            if (body != null)
                body.AddForce(Force);
            onForce.Invoke(Force);
        }

        private void Tell()
        {
            if (_link.Failure != null)
            {
                Debug.LogError("HapticMaster: " + _link.Failure, this);
                enabled = false;
                return;
            }
            _told = _link.State;
            if (_told == SessionState.Closed)
                Debug.LogError("HapticMaster: the slave ended the session: " + _link.Reason, this);
            else
                Debug.Log("HapticMaster: " + _told.ToString().ToLowerInvariant() + " " + _link.Scene, this);
            if (_told == SessionState.Closed)
                enabled = false;
        }
    }
}
